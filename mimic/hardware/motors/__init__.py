"""Motors of any maker and an IMU on CAN: what they say, and what can be said to them."""

"""Real robots: buses, motors, IMU, pre-flight checks, the process that sends, the plant over it."""

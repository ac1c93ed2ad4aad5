"""The stock CyberDog 2: its firmware's motor interface, spoken over LCM."""

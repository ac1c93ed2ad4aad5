"""Real robots: buses, motors, IMU, pre-flight checks, watchdog, shutdown."""

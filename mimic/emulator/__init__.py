"""The robot behind its real protocols, emulated: motors, IMU, buses, faults."""

"""A Unitree Go2 EDU: its low-level interface, spoken over DDS."""

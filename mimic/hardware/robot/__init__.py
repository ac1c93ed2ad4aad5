"""Driving a robot, on whatever it is reached: the process that sends, the plant over it, and the pre-flight before."""

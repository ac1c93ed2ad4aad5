"""Before a robot on CAN runs: finding its motors, its wiring and its zeros, watching it, and logging it suspended."""

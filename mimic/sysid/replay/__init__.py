"""Replays of a log on the model, on the CPU and on a GPU."""

"""Logged commands through the model, and the numbers that explain the log."""

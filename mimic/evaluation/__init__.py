"""Evaluating a policy in plain MuJoCo."""

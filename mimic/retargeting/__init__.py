"""Retargeting: a person's landmarks to toe targets and commands of the robot."""

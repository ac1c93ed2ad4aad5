"""The robot in MuJoCo as a plant."""

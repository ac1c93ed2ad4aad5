"""What the robot is: description, model, reach, and what varies from robot to robot."""

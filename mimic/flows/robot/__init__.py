"""What is done with a real robot."""

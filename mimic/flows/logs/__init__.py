"""What is done with logs of machines."""

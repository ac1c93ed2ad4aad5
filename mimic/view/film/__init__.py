"""Film of person and robot side by side."""

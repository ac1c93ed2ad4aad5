"""CAN buses: frames, links, load."""

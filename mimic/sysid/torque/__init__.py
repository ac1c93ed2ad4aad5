"""What the torques say of effects, within seconds."""

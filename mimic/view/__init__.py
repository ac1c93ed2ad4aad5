"""What a run looks like: a Rerun scene, a film of human and robot side by side, single pictures."""

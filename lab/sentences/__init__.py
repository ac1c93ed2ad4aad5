"""200 natural sentences, and checks of the motion that a planner makes of them."""

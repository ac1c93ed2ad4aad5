"""PPO: updates, checkpoints, what a training begins with, and the network as a file."""

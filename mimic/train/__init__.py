"""Batched worlds, rewards and PPO: the training of the low-level policy. Needs the extra ``train``."""

"""Recorded motion: .npz, .trc, .bvh."""

"""Videos and cameras: decoding, pose estimation, smoothing."""

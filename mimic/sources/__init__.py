"""Sources of human motion: each turns a file, a device or a sentence into one track with true times."""

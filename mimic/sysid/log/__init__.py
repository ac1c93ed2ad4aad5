"""What a log holds: checks, noise, gaps, encoder steps, blocks of time."""

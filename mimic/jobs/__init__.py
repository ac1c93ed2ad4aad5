"""Independent jobs on local processes."""

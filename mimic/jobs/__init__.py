"""Independent jobs on local processes or a Ray cluster."""

"""Which effects the logs ask for, by one rule."""

"""A log and a model become an error, its cause, and a better model."""

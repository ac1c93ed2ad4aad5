"""What a policy promises, and how it is run."""

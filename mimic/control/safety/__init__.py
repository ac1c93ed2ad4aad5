"""What may go wrong, and what is done about it: rules, limits, and who decides."""

"""Model selection: which effect is missing, with evidence."""

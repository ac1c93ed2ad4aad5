"""Mutants: one token of mimic/ is changed, and the tests of the mirrored folder must notice."""

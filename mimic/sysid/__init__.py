"""System identification: what a model lacks, from a log of the machine."""

"""One pass over a log: prediction errors of a machine, what explains them, and which effects it has."""

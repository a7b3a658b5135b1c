"""The simulator: a batched cloth solver, its settings, execution of manipulations and recording of sequences."""

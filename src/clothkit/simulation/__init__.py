"""The world: a batched cloth solver, its settings, execution of manipulations, and recorded sequences."""

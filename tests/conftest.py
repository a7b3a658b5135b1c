"""Strict tests: array shapes and types are checked against their annotations at every call, warnings are errors."""

import os

# Tests compile much and compute little.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")

import hypothesis
import jaxtyping

FLOORS = ("cloth", "manipulation", "dataset", "networks", "estimation", "planning", "evaluation", "report")

# Not in simulation, where the annotations of Warp's kernels are Warp's own.
HOOK = jaxtyping.install_import_hook([f"clothkit.{floor}" for floor in FLOORS], "beartype.beartype")

hypothesis.settings.register_profile("clothkit", max_examples=20, deadline=None, derandomize=True)
hypothesis.settings.load_profile("clothkit")

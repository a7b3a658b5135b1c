"""Strict tests: array shapes and types are checked against their annotations at every call, warnings are errors."""

import os

os.environ.setdefault("XLA_FLAGS", "--xla_force_host_platform_device_count=1")

import hypothesis
import jaxtyping

# Shapes are checked everywhere but in Warp's kernels, whose annotations are Warp's own, and in pydantic's models.
HOOK = jaxtyping.install_import_hook(
    [
        f"clothkit.{floor}"
        for floor in (
            "cloth",
            "manipulation",
            "dataset",
            "networks",
            "estimation",
            "planning",
            "evaluation",
            "report",
        )
    ],
    "beartype.beartype",
)

hypothesis.settings.register_profile("clothkit", max_examples=20, deadline=None, derandomize=True)
hypothesis.settings.load_profile("clothkit")

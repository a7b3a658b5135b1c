"""Strict tests: array shapes and types are checked against their annotations at every call, warnings are errors."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

# Tests compile much and compute little; many of them, and the stages that they start, compile the same programs.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
OWN_CACHE = None
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    OWN_CACHE = os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="clothkit-tests-")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

import hypothesis
import jax
import jaxtyping
import pytest

MOST_MAPS = 10_000

FLOORS = (
    "cloth",
    "manipulation",
    "dataset",
    "models",
    "training",
    "observation",
    "estimation",
    "planning",
    "episodes",
    "evaluation",
    "goals",
    "prebuilt",
    "report",
    "environment",
    "app",
)

# Not in simulation, where the annotations of Warp's kernels are Warp's own.
HOOK = jaxtyping.install_import_hook([f"clothkit.{floor}" for floor in FLOORS], "beartype.beartype")

hypothesis.settings.register_profile("clothkit", max_examples=20, deadline=None, derandomize=True)
hypothesis.settings.load_profile("clothkit")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The chain first: it takes longest, and the other files fit beside it (xdist is told to keep the order)."""
    items.sort(key=lambda item: "pipeline" not in item.path.parts)


@pytest.fixture(autouse=True, scope="module")
def few_programs() -> Iterator[None]:
    """Unload compiled programs after a file, once there are many.

    Each maps pieces of memory of its own. A process has at most `vm.max_map_count` of them (65,530 by default), and
    XLA ends it with a segmentation fault when there are no more.
    """
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()


def pytest_unconfigure() -> None:
    """Drop the compiled programs, in the process that made the directory for them."""
    if OWN_CACHE:
        shutil.rmtree(OWN_CACHE, ignore_errors=True)

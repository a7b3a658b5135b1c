"""Training on two devices: each takes half of a batch, and both find the gradient that one device finds."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from clothkit.training.pemd import problem, sequences
from tests.crumpled import crumpled
from tests.training.test_loop import PEMD

TWO = "--xla_force_host_platform_device_count=2"


def found() -> dict[str, np.ndarray]:
    """The gradient of a batch, by weight."""
    data = sequences(replace(crumpled(6, 0), length=np.ones(6, np.int8)))
    learnt = problem(PEMD, data)
    gradient, _ = jax.jit(learnt.gradient)(learnt.initial(jax.random.key(0)), data, jax.random.key(1))
    return {jax.tree_util.keystr(path): np.asarray(g) for path, g in jax.tree_util.tree_leaves_with_path(gradient)}


SCRIPT = """
import sys
import jax, numpy as np
from jax.sharding import NamedSharding
from clothkit.training.devices import on_all, spread
from tests.training.test_devices import found

assert jax.device_count() == 2
halves = jax.jit(lambda x: spread(x + 1))(on_all(np.zeros((8, 3)))).addressable_shards
assert [half.data.shape for half in halves] == [(4, 3), (4, 3)]
np.savez(sys.argv[1], **found())
spread(np.zeros((7, 3)))
"""


def test_two_devices_find_what_one_finds(tmp_path: Path) -> None:
    """And refuse a batch that they can't share."""
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path / "gradient.npz")],
        env=os.environ | {"XLA_FLAGS": TWO, "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        cwd=Path(__file__).resolve().parents[2],
        check=False,
    )
    assert "training.batch is 7; 2 devices need a multiple of 2" in run.stderr
    with np.load(tmp_path / "gradient.npz") as two:
        for name, gradient in found().items():
            assert two[name] == pytest.approx(gradient, rel=1e-4, abs=1e-6)

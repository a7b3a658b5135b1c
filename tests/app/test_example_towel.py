"""The example of README's first command is what its script writes."""

import runpy
from pathlib import Path

import numpy as np
import trimesh

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_towel_is_what_its_script_writes() -> None:
    kept = np.asarray(trimesh.load(EXAMPLES / "towel.ply").vertices)
    written = runpy.run_path(str(EXAMPLES / "make_towel.py"))["towel"]()
    np.testing.assert_allclose(kept, written, atol=1e-6)

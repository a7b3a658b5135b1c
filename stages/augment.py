"""Inserts null manipulations into the training split, and rotates and mirrors it: `python stages/augment.py`."""

from pathlib import Path

from clothkit.dataset.augment import augmented
from clothkit.dataset.store import save_parts
from clothkit.runtime.stage import stage

MESHES = Path("data/meshes.zarr")

with stage("augment") as run:
    work = run.work(inputs=[MESHES])
    save_parts(work / "augmented.zarr", augmented(MESHES, run.params), run.attributes)
    run.publish(work / "augmented.zarr", "data/augmented.zarr")

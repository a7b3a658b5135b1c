"""Inserts null manipulations into the training split, and rotates and mirrors it: `python stages/augment.py`."""

from pathlib import Path

from clothkit.dataset.augment import augment
from clothkit.dataset.store import load, save
from clothkit.runtime.stage import stage

MESHES = Path("data/meshes.zarr")

with stage("augment") as run:
    work = run.work(inputs=[MESHES])
    save(work / "augmented.zarr", augment(load(MESHES).of_split("train"), run.params), run.attributes)
    run.publish(work / "augmented.zarr", "data/augmented.zarr")

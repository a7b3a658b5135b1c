"""The training split with nulls inserted, rotated and mirrored.  python stages/augment.py"""

from pathlib import Path

from clothkit.dataset.augment import augment
from clothkit.dataset.store import load, save
from clothkit.stage import stage

MESHES = Path("data/meshes.zarr")

with stage("augment") as run:
    work = run.work(inputs=[MESHES])
    save(work / "augmented.zarr", augment(load(MESHES).of_split("train"), run.params), run.attributes)
    run.publish(work / "augmented.zarr", "data/augmented.zarr")

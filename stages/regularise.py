"""Converts raw states to normalised, centred meshes with splits: `python stages/regularise.py`."""

from pathlib import Path

from clothkit.dataset.regularise import regularise
from clothkit.dataset.store import save
from clothkit.runtime.stage import stage

RAW = Path("data/raw")

with stage("regularise") as run:
    work = run.work(inputs=[RAW])
    save(work / "meshes.zarr", regularise(RAW, run.params), run.attributes)
    run.publish(work / "meshes.zarr", "data/meshes.zarr")

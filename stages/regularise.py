"""Converts raw states to normalised, centred meshes with splits: `python stages/regularise.py`."""

from pathlib import Path

from clothkit.dataset.regularise import regularised
from clothkit.dataset.store import save_parts
from clothkit.runtime.stage import stage

RAW = Path("data/raw")

with stage("regularise") as run:
    work = run.work(inputs=[RAW])
    save_parts(work / "meshes.zarr", regularised(RAW, run.params), run.attributes)
    run.publish(work / "meshes.zarr", "data/meshes.zarr")

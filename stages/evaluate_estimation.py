"""Estimates the evaluated sequences' states and computes their errors: `python stages/evaluate_estimation.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation import arrays, estimation
from clothkit.models.store import load
from clothkit.runtime.stage import stage


def main() -> None:
    """Write data/evaluation/estimates.zarr and estimation.parquet."""
    with stage("evaluate_estimation") as s:
        meshes, vtm = Path("data/meshes.zarr"), Path("data/nets/vtm")
        work = s.work(inputs=[meshes, vtm])
        dataset = store.load(meshes)
        found = estimation.estimates(dataset, load(vtm, "vtm"), s.params, s.shared.stages.plan.refine)
        write_rows(work / "estimation.parquet", estimation.rows(dataset, found), s.attributes)
        arrays.save(work / "estimates.zarr", found._asdict(), arrays.ESTIMATES, s.attributes)
        s.publish(work / "estimates.zarr", "data/evaluation/estimates.zarr")
        s.publish(work / "estimation.parquet", "data/evaluation/estimation.parquet")


if __name__ == "__main__":
    main()

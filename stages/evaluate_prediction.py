"""Predicts all tasks of the evaluated sequences and computes the errors: `python stages/evaluate_prediction.py`."""

from pathlib import Path

import pandas as pd

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation import arrays, calibration, comparisons, prediction, voxel_prediction
from clothkit.models.ensemble import folders, load
from clothkit.models.store import Kind
from clothkit.runtime.stage import is_left_out, stage

MESHES, ESTIMATES = Path("data/meshes.zarr"), Path("data/evaluation/estimates.zarr")
NETS = Path("data/nets")
KINDS: tuple[Kind, Kind] = ("pemd", "emd_voxel")


def main() -> None:
    """Write prediction.parquet, comparisons.parquet, calibration.parquet and predictions.zarr in data/evaluation."""
    with stage("evaluate_prediction") as s:
        members = s.shared.ensemble.members
        of_kind = {kind: list(folders(NETS, kind, members).values()) for kind in KINDS}
        kinds = [kind for kind, found in of_kind.items() if not any(map(is_left_out, found))]
        paths = [path for kind in kinds for path in of_kind[kind]]
        work = s.work(inputs=[MESHES, ESTIMATES, *paths])
        dataset = store.load(MESHES)
        estimates = arrays.load(ESTIMATES, arrays.ESTIMATES)
        given = prediction.starts(dataset, estimates)
        nets = load(NETS, "pemd", members)
        found = [prediction.rows(dataset, given, nets, s.params)]
        if "emd_voxel" in kinds:
            voxel_nets = load(NETS, "emd_voxel", members)
            found.append(voxel_prediction.rows(dataset, given.sequence, voxel_nets, s.params))
        rows = pd.concat(found, ignore_index=True)
        write_rows(work / "prediction.parquet", rows, s.attributes)
        coverage = calibration.rows(dataset, given, nets.best_net, estimates, s.params)
        write_rows(work / "calibration.parquet", coverage, s.attributes)
        write_rows(work / "comparisons.parquet", comparisons.of_predictions(rows), s.attributes)
        stored = prediction.stored(dataset, given, nets.best_net, s.params)
        arrays.save(work / "predictions.zarr", stored, arrays.PREDICTIONS, s.attributes)
        for name in ("predictions.zarr", "prediction.parquet", "comparisons.parquet", "calibration.parquet"):
            s.publish(work / name, f"data/evaluation/{name}")


if __name__ == "__main__":
    main()

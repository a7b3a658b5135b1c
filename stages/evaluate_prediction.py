"""Predicts all tasks of the evaluated sequences and computes the errors: `python stages/evaluate_prediction.py`."""

from pathlib import Path

import pandas as pd

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation import arrays, calibration, comparisons, prediction, voxel_prediction
from clothkit.models.store import load
from clothkit.planning.systems import better_net
from clothkit.stage import stage

MESHES, ESTIMATES = Path("data/meshes.zarr"), Path("data/evaluation/estimates.zarr")
NETS = {"a": Path("data/nets/pemd_a"), "b": Path("data/nets/pemd_b")}
VOXEL_NETS = {"a": Path("data/nets/emd_voxel_a"), "b": Path("data/nets/emd_voxel_b")}


def main() -> None:
    """Write prediction.parquet, comparisons.parquet, calibration.parquet and predictions.zarr in data/evaluation."""
    with stage("evaluate_prediction") as s:
        work = s.work(inputs=[MESHES, ESTIMATES, *NETS.values(), *VOXEL_NETS.values()])
        dataset = store.load(MESHES)
        estimates = arrays.load(ESTIMATES, arrays.ESTIMATES)
        given = prediction.starts(dataset, estimates)
        nets = {name: load(folder, "pemd") for name, folder in NETS.items()}
        voxel_nets = {name: load(folder, "emd_voxel") for name, folder in VOXEL_NETS.items()}
        better = better_net(NETS)
        of_meshes = prediction.rows(dataset, given, nets, better, s.params)
        of_voxels = voxel_prediction.rows(dataset, given.sequence, voxel_nets, better_net(VOXEL_NETS), s.params)
        rows = pd.concat([of_meshes, of_voxels], ignore_index=True)
        write_rows(work / "prediction.parquet", rows, s.attributes)
        coverage = calibration.rows(dataset, given, nets[better], estimates, s.params)
        write_rows(work / "calibration.parquet", coverage, s.attributes)
        write_rows(work / "comparisons.parquet", comparisons.of_predictions(rows), s.attributes)
        stored = prediction.stored(dataset, given, nets[better], s.params)
        arrays.save(work / "predictions.zarr", stored, s.attributes)
        for name in ("predictions.zarr", "prediction.parquet", "comparisons.parquet", "calibration.parquet"):
            s.publish(work / name, f"data/evaluation/{name}")


if __name__ == "__main__":
    main()

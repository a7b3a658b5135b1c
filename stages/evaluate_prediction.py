"""Predicts every task of the evaluated sequences, and scores that: `python stages/evaluate_prediction.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation import arrays, calibration, prediction
from clothkit.networks.store import load
from clothkit.planning.systems import better_net
from clothkit.stage import stage

MESHES, ESTIMATES = Path("data/meshes.zarr"), Path("data/evaluation/estimates.zarr")
NETS = {"a": Path("data/nets/pemd_a"), "b": Path("data/nets/pemd_b")}


def main() -> None:
    """Write data/evaluation/prediction.parquet, calibration.parquet and predictions.zarr."""
    with stage("evaluate_prediction") as s:
        work = s.work(inputs=[MESHES, ESTIMATES, *NETS.values()])
        dataset = store.load(MESHES)
        estimates = arrays.load(ESTIMATES, ("sequence", "mean", "std", "mesh", "label"))
        given = prediction.starts(dataset, estimates)
        nets = {name: load(folder) for name, folder in NETS.items()}
        better = better_net(NETS)
        rows = prediction.rows(dataset, given, nets, better, s.params)
        write_rows(work / "prediction.parquet", rows, s.attributes)
        coverage = calibration.rows(dataset, given, nets[better], estimates, s.params)
        write_rows(work / "calibration.parquet", coverage, s.attributes)
        stored = prediction.stored(dataset, given, nets[better], s.params)
        arrays.save(work / "predictions.zarr", stored, s.attributes)
        s.publish(work / "predictions.zarr", "data/evaluation/predictions.zarr")
        s.publish(work / "prediction.parquet", "data/evaluation/prediction.parquet")
        s.publish(work / "calibration.parquet", "data/evaluation/calibration.parquet")


if __name__ == "__main__":
    main()

"""Predicts every task of the evaluated sequences, and scores that: `python stages/evaluate_prediction.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation import arrays, prediction
from clothkit.networks.store import load
from clothkit.planning.systems import better_net
from clothkit.stage import stage

MESHES, ESTIMATES = Path("data/meshes.zarr"), Path("data/evaluation/estimates.zarr")
NETS = {"a": Path("data/nets/pemd_a"), "b": Path("data/nets/pemd_b")}


def main() -> None:
    """Write data/evaluation/prediction.parquet and predictions.zarr."""
    with stage("evaluate_prediction") as s:
        work = s.work(inputs=[MESHES, ESTIMATES, *NETS.values()])
        dataset = store.load(MESHES)
        given = prediction.starts(dataset, arrays.load(ESTIMATES, ("sequence", "mesh", "label")))
        nets = {name: load(folder) for name, folder in NETS.items()}
        better = better_net(NETS)
        rows = prediction.rows(dataset, given, nets, better, s.params)
        write_rows(work / "prediction.parquet", rows, s.attributes)
        stored = prediction.stored(dataset, given, nets[better], s.params)
        arrays.save(work / "predictions.zarr", stored, s.attributes)
        s.publish(work / "predictions.zarr", "data/evaluation/predictions.zarr")
        s.publish(work / "prediction.parquet", "data/evaluation/prediction.parquet")


if __name__ == "__main__":
    main()

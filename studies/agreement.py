"""From which agreement on does an estimate explain what was seen?  python studies/agreement.py [SEQUENCES] [options]

Estimates the states of the first validation sequences (all if not said) as `clothkit estimate` does, and holds each
estimate against what it was made of (`estimation.agreement`). A row per condition and state goes to
reports/<scale>/studies/agreement.csv: silhouette and heights, intersection over union, and the estimate's error. What
is there already is not done again, unless it was made with another net, other data or other settings (`made_with`),
whose rows are dropped.

The conditions `voxels` (what training shows, without noise) and `camera` (pictures of evaluate_camera, noise x 1) are
those of states that the net knows. The thresholds that are proposed (`app.agreement`) warn of at most the share
`--alarms` of them (0.02), whichever of the two is worse. `heights x 2` and `heights x 4` show cloths that are thicker
than any in the data: of these a warning is right. What is printed tells how many get one, and the mean errors of states
with and without one. Needs the dataset and VtM (`dvc repro train_vtm`), under `--data FOLDER` (data).
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from made_with import NAME, joined, made_with, read

from clothkit.cloth import voxels
from clothkit.dataset import store as meshes
from clothkit.dataset.store import STATES
from clothkit.errors import InputError
from clothkit.estimation.agreement import Agreement, agreement, proposed
from clothkit.estimation.estimate import estimate
from clothkit.evaluation.errors import errors
from clothkit.networks import store
from clothkit.networks.net import Net
from clothkit.observation.noise import NoiseConfig
from clothkit.observation.picture import PictureConfig, take
from clothkit.params import load_params

KNOWN = ("voxels", "camera")
BATCH = 64
Shower = Callable[[np.ndarray], np.ndarray | None]


def conditions(net: Net, pictures: PictureConfig) -> dict[str, Shower]:
    """How a mesh is shown, as voxels; None where the camera does not find its cloth."""
    height = net.config.height

    def camera(mesh: np.ndarray) -> np.ndarray | None:
        try:
            return take(mesh, pictures).observation.voxels
        except InputError:
            return None

    def thick(factor: float) -> Shower:
        return lambda mesh: np.asarray(voxels.observe(mesh * np.array([1, 1, factor], np.float32), height=height))

    return {"voxels": thick(1.0), "camera": camera, "heights x 2": thick(2.0), "heights x 4": thick(4.0)}


def main() -> None:
    """Do what is asked, print how often each threshold warns, and propose some."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?")
    parser.add_argument("--alarms", type=float, default=0.02)
    parser.add_argument("--data", type=Path, default=Path("data"))
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    refine, pictures = params.stages.plan.refine, params.stages.evaluate_camera.picture
    paths = asked.data / "meshes.zarr", asked.data / "nets/vtm"
    dataset, net = meshes.load(paths[0]), store.load(paths[1])
    # As evaluate_camera has them: tilted, its noise as measured, the viewport that of the net.
    pictures = dataclasses.replace(
        pictures,
        camera=dataclasses.replace(pictures.camera, tilt=0.35),
        noise=pictures.noise or NoiseConfig(),
        cloud=dataclasses.replace(pictures.cloud, height=net.config.height),
    )
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    path, made = folder / "agreement.csv", made_with(paths, refine, pictures)
    table = read(path, ["condition", "sequence", "state", "silhouette", "heights", "error"], made)
    sequences = dataset.indices("validation")[: asked.sequences]
    for name, show in conditions(net, pictures).items():
        done = set(table.loc[table["condition"] == name, "sequence"])
        places = [(s, i) for s in sequences.tolist() if s not in done for i in range(STATES) if i <= dataset.length[s]]
        found = []
        for start in range(0, len(places), BATCH):
            truth = np.stack([dataset.vertices[place] for place in places[start : start + BATCH]])
            shown = [show(mesh) for mesh in truth]
            kept = [i for i, seen in enumerate(shown) if seen is not None]
            # A last batch that is filled up needs no compilation of its own.
            filled = np.stack([np.asarray(shown[kept[min(i, len(kept) - 1)]]) for i in range(BATCH)])
            estimated = np.asarray(estimate(net, filled, refine).mesh)[: len(kept)]
            agreed = agreement(estimated, filled[: len(kept)], height=net.config.height)
            of_batch = pd.DataFrame([places[start + i] for i in kept], columns=["sequence", "state"])
            of_batch = of_batch.assign(silhouette=agreed.silhouette, heights=agreed.heights)
            found.append(of_batch.assign(error=errors(estimated, truth[kept])))
        if found:
            table = joined(table, pd.concat(found).assign(condition=name, **{NAME: made}))
            table.to_csv(path, index=False, lineterminator="\n", float_format="%.5g")
            print(f"{name}: {len(places)} states", flush=True)
    table = table[table["sequence"].isin(sequences)]
    known = [_agreement(table[table["condition"] == name]) for name in KNOWN]
    least = proposed(known, alarms=asked.alarms)
    warned = ~_agreement(table).explains(least)
    print(
        table.groupby("condition")[["silhouette", "heights"]].describe(percentiles=[0.01, 0.02, 0.05, 0.5]).T.round(3)
    )
    print(table.assign(warned=warned).groupby(["condition", "state"])["warned"].mean().unstack().round(3))
    print(table.assign(warned=warned).groupby(["condition", "warned"])["error"].mean().unstack().round(3))
    print(f"app.agreement: silhouette {least.silhouette:.2f}, heights {least.heights:.2f}")


def _agreement(rows: pd.DataFrame) -> Agreement:
    return Agreement(rows["silhouette"].to_numpy(float), rows["heights"].to_numpy(float))


if __name__ == "__main__":
    main()

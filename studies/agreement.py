"""At which agreement does an estimate explain its observation?  python studies/agreement.py [SEQUENCES] [options]

Estimates the states of the first validation sequences (default: all) as `clothkit estimate` does, and compares each
estimate with the observation that it was made from (`estimation.agreement`). A row per condition and state goes to
reports/<scale>/studies/agreement.csv: the intersection over union of silhouettes and of heights, and the estimate's
error. Existing rows are not computed again; rows made with another net, other data or other settings (`fingerprint`)
are dropped.

The conditions `voxels` (voxels as in training, without noise) and `camera` (pictures as in evaluate_camera, noise x 1)
show states like those in the training data. The proposed thresholds (`app.agreement`) give warnings for at most the
fraction `--alarms` (default: 0.02) of the states in each of these two conditions. The conditions `heights x 2` and
`heights x 4` show cloths that are thicker than any in the data, for which a warning is right. The study prints how many
states get a warning, and the mean errors of states with and without one. Needs the dataset and VtM
(`dvc repro train_vtm`) in the folder `--data FOLDER` (default: data).
"""

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from fingerprint import COLUMN, append, fingerprint, read, write

from clothkit.cloth import voxels
from clothkit.dataset import store as meshes
from clothkit.dataset.store import STATES
from clothkit.estimation.agreement import Agreement, agreement, proposed
from clothkit.estimation.estimate import estimate
from clothkit.evaluation.errors import errors
from clothkit.models import store
from clothkit.models.net import Net
from clothkit.observation.noise import NoiseConfig
from clothkit.observation.picture import PictureConfig, take
from clothkit.params import load_params
from clothkit.runtime.errors import InputError

KNOWN = ("voxels", "camera")
BATCH = 64
Shower = Callable[[np.ndarray], np.ndarray | None]


def conditions(net: Net, pictures: PictureConfig) -> dict[str, Shower]:
    """Return, per condition, the function from a mesh to its observed voxels; None if the camera finds no cloth."""
    viewport = net.config.viewport

    def camera(mesh: np.ndarray) -> np.ndarray | None:
        try:
            return take(mesh, pictures).observation.voxels
        except InputError:
            return None

    def thick(factor: float) -> Shower:
        return lambda mesh: np.asarray(voxels.observe(mesh * np.array([1, 1, factor], np.float32), viewport=viewport))

    return {"voxels": thick(1.0), "camera": camera, "heights x 2": thick(2.0), "heights x 4": thick(4.0)}


def main() -> None:
    """Run the study, print the agreements and the fractions of warnings, and propose thresholds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?")
    parser.add_argument("--alarms", type=float, default=0.02)
    parser.add_argument("--data", type=Path, default=Path("data"))
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    refine, pictures = params.stages.plan.refine, params.stages.evaluate_camera.picture
    paths = asked.data / "meshes.zarr", asked.data / "nets/vtm"
    dataset, net = meshes.load(paths[0]), store.load(paths[1])
    # Pictures as in evaluate_camera: a tilted view, noise x 1, the net's viewport.
    pictures = dataclasses.replace(
        pictures,
        camera=dataclasses.replace(pictures.camera, tilt=0.35),
        noise=pictures.noise or NoiseConfig(),
        cloud=dataclasses.replace(pictures.cloud, viewport=net.config.viewport),
    )
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    path, current = folder / "agreement.csv", fingerprint(paths, refine, pictures)
    table = read(path, ["condition", "sequence", "state", "silhouette", "heights", "error"], current)
    sequences = dataset.indices("validation")[: asked.sequences]
    for name, show in conditions(net, pictures).items():
        done = set(table.loc[table["condition"] == name, "sequence"])
        places = [(s, i) for s in sequences.tolist() if s not in done for i in range(STATES) if i <= dataset.length[s]]
        found = []
        for start in range(0, len(places), BATCH):
            truth = np.stack([dataset.vertices[place] for place in places[start : start + BATCH]])
            shown = [show(mesh) for mesh in truth]
            kept = [i for i, seen in enumerate(shown) if seen is not None]
            # The last batch is padded to the same size, which avoids another compilation.
            filled = np.stack([np.asarray(shown[kept[min(i, len(kept) - 1)]]) for i in range(BATCH)])
            estimated = np.asarray(estimate(net, filled, refine).mesh)[: len(kept)]
            agreed = agreement(estimated, filled[: len(kept)], viewport=net.config.viewport)
            of_batch = pd.DataFrame([places[start + i] for i in kept], columns=["sequence", "state"])
            of_batch = of_batch.assign(silhouette=agreed.silhouette, heights=agreed.heights)
            found.append(of_batch.assign(error=errors(estimated, truth[kept])))
        if found:
            table = append(table, pd.concat(found).assign(condition=name, **{COLUMN: current}))
            write(table, path)
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

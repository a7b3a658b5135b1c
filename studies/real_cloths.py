"""How well are real cloths of another laboratory estimated?  python studies/real_cloths.py FOLDER [options]

FOLDER holds depth images from above as TRTM (Wang, Li, Zamora, Coros, ICRA 2024) publishes them: `real/NAME.png`, some
with NAME.json, in which `corner_markers_m` has the visible corner markers' positions; and `simulated/NN.png` with
NN.txt, the true mesh of 21 x 21 vertices. Every image is converted to points, observed and estimated as
`clothkit estimate` does. Other cloths are read from `clouds/NAME.ply` (or another file that holds a point cloud, in
metres, the table at z = 0, the cloth's points alone or with a mask) with NAME.json: `sides` [m], `thickness` [m], and
`corner_markers_m` or `mesh`, the path of a mesh file in the cloud's frame. A row per image or cloud goes to
reports/<scale>/studies/real_cloths.csv, with a hash of net and settings, and means to real_cloths_summary.csv:

- corners_cm: mean distance of the visible markers to the estimate's corners, matched at least cost; markers lie 1.4 to
  1.8 cm inside the corners.
- vertices_cm: mean distance of the estimate's vertices to the true mesh's, in the labelling that fits best.
- iou: intersection over union of the silhouettes of points and estimate; columns and heights: of the voxels.

The net is that in the folder `--data` (default: data), and is told sides and thickness. `--seeds 1 2` trains others,
with these seeds and otherwise alike, on the dataset in `--data`, and has rows of each: how much is luck? `--ways`
trains nets with the seed of the chain in other ways:

longer       with three times the iterations
wider        with hidden layers of twice the width
hypotheses   with two hypotheses
four         with four hypotheses
more data    on the training sequences of `--also FOLDER`, too, such as those of another scale

Rows of other nets stay in the table. With `--pictures FOLDER`, observation, estimate and both on one
another are drawn; do not publish them if the images' licence does not allow it.
"""

import argparse
import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import pandas as pd
from fingerprint import COLUMN, fingerprint
from jaxtyping import Float
from scipy.ndimage import map_coordinates
from scipy.optimize import linear_sum_assignment
from trained import train_estimator

from clothkit.cloth.symmetry import equivalents
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, rectangle
from clothkit.dataset.store import Dataset, load
from clothkit.estimation.agreement import agreement
from clothkit.estimation.estimate import estimate
from clothkit.estimation.refine import RefineConfig
from clothkit.models import store
from clothkit.models.net import Net
from clothkit.observation.cloud import Observation, observe_cloud
from clothkit.observation.coverage import goal_iou
from clothkit.observation.files import read
from clothkit.observation.plane import LEVEL
from clothkit.observation.settings import CloudConfig
from clothkit.observation.states import MeshState, PointCloud
from clothkit.params import Params, load_params
from clothkit.runtime.errors import InputError
from clothkit.runtime.json_file import read_json
from clothkit.training.settings import TrainVtMConfig

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SIDES = {"rectangle": (0.25, 0.17)}
"""Sides of cloths that are no squares of SIDE [m], by the first part of their name."""
SIDE = 0.25
THICKNESS = {"larger_square": 0.005, "template_square": 0.005, "rectangle": 0.003, "simulated": 0.0035}
"""Thickness of the cloths [m]: the height at which flat ones are seen."""

PIXEL, MIDDLE, TABLE, PER_METRE = 0.25 / 480, 360, 193.0, 2000.0
"""Of real images: metres a pixel, the middle pixel, the table's value, counts a metre."""
UNIT, UNIT_PIXELS, UNIT_MIDDLE, UNIT_TABLE, PER_UNIT = 0.125, 186.0, 276.0, 200.95, 250.3
"""Of simulated ones: metres a unit of length, pixels a unit, the middle pixel, the table's value, counts a unit."""
EMPTY = 254
"""Value from which a pixel shows no cloth."""

CHAIN, MORE = "chain", "more data"
WAYS: dict[str, Callable[[TrainVtMConfig], TrainVtMConfig]] = {
    "longer": lambda own: dataclasses.replace(
        own, training=dataclasses.replace(own.training, iterations=3 * own.training.iterations)
    ),
    "wider": lambda own: dataclasses.replace(own, net=dataclasses.replace(own.net, hidden=2 * own.net.hidden)),
    "hypotheses": lambda own: dataclasses.replace(own, net=dataclasses.replace(own.net, hypotheses=2)),
    "four": lambda own: dataclasses.replace(own, net=dataclasses.replace(own.net, hypotheses=4)),
    MORE: lambda own: own,
}
"""Other ways to train than that of the chain."""
KEYS = ["way", "seed", "image"]


class Picture(NamedTuple):
    """A depth image as points, and what is known of its cloth."""

    name: str
    points: Float[np.ndarray, "points 3"]
    """Metres; the table is z = 0."""
    sides: tuple[float, float]
    thickness: float
    markers: Float[np.ndarray, "markers 2"] | None = None
    """Visible corner markers xy [m]."""
    mesh: Float[np.ndarray, "u v 3"] | None = None
    """The true mesh [m]."""


def pictures(folder: Path) -> Iterator[Picture]:
    """Read the images. Raises InputError if there are none."""
    files = [*sorted((folder / "real").glob("*.png")), *sorted((folder / "simulated").glob("*.png"))]
    clouds = sorted((folder / "clouds").glob("*.json"))
    if not files and not clouds:
        raise InputError(f"{folder}: holds neither real/*.png nor simulated/*.png nor clouds/*.json")
    yield from map(cloud, clouds)
    for file in files:
        values = np.asarray(plt.imread(file), float) * 255
        values = values[..., 0] if values.ndim == 3 else values
        row, column = np.nonzero(values < EMPTY)
        seen = values[row, column]
        if file.parent.name == "real":
            kind = file.stem.rsplit("_", 1)[0]
            if kind not in THICKNESS:
                raise InputError(f"{file}: expected a name that begins with one of {', '.join(THICKNESS)}")
            xy = np.stack([column - MIDDLE, MIDDLE - row], axis=-1) * PIXEL
            points = np.column_stack([xy, (TABLE - seen) / PER_METRE])
            notes = file.with_suffix(".json")
            markers = np.array(json.loads(notes.read_text())["corner_markers_m"]) if notes.exists() else None
            yield Picture(file.stem, points, SIDES.get(kind, (SIDE, SIDE)), THICKNESS[kind], markers)
        else:
            xy = np.stack([column - UNIT_MIDDLE, UNIT_MIDDLE - row], axis=-1) / UNIT_PIXELS
            points = np.column_stack([xy, (UNIT_TABLE - seen) / PER_UNIT]) * UNIT
            mesh = np.loadtxt(file.with_suffix(".txt")).reshape(21, 21, 3) * UNIT
            yield Picture(f"simulated_{file.stem}", points, (SIDE, SIDE), THICKNESS["simulated"], mesh=mesh)


def cloud(notes: Path) -> Picture:
    """Read a cloud and what its notes tell. Raises InputError if a file is missing or tells something else."""
    told = read_json(notes, expected="what is known of a cloth")
    files = [file for file in sorted(notes.parent.glob(f"{notes.stem}.*")) if file != notes]
    if len(files) != 1 or not {"sides", "thickness"} <= set(told):
        raise InputError(f"{notes}: expected one file of points beside it, and sides and thickness in it")
    state = read(files[0])
    if not isinstance(state, PointCloud):
        raise InputError(f"{files[0]}: expected a point cloud")
    points = state.points if state.cloth is None else state.points[state.cloth]
    side_u, side_v = map(float, told["sides"])
    markers, mesh = (told.get(name) for name in ("corner_markers_m", "mesh"))
    if mesh is not None:
        topology = SQUARE if side_u == side_v else rectangle(side_u / side_v)
        found = read(notes.parent / mesh, cloth_side=max(side_u, side_v), topology=topology)
        if not isinstance(found, MeshState):
            raise InputError(f"{notes}: {mesh} is no mesh")
        mesh = found.pose.normalised_to_table(found.mesh.astype(float))
    markers = None if markers is None else np.array(markers, float)
    return Picture(notes.stem, points, (side_u, side_v), float(told["thickness"]), markers, mesh)


def observed(picture: Picture, settings: CloudConfig) -> Observation:
    """Observe the cloth, all of whose points are the cloth's; heights are those of its upper side."""
    settings = dataclasses.replace(settings, surface=picture.thickness / 2)
    everything = PointCloud(picture.points, cloth=np.ones(len(picture.points), bool))
    return observe_cloud(everything, cloth_side=max(picture.sides), settings=settings, table=LEVEL, name=picture.name)


def estimated(picture: Picture, observation: Observation, net: Net, refine: RefineConfig) -> Float[np.ndarray, "u v 3"]:
    """Return the refined estimate, normalised and centred."""
    measures = np.array([*picture.sides, picture.thickness], np.float32) * (CLOTH_LENGTH / max(picture.sides))
    return np.asarray(estimate(net, observation.voxels[None], refine, cloth=measures[None]).mesh[0])


def row_of(picture: Picture, observation: Observation, mesh: Float[np.ndarray, "u v 3"], net: Net) -> dict:
    """Return what the study tells of an image."""
    placed = observation.pose.normalised_to_table(mesh.astype(float))
    agrees = agreement(mesh[None], observation.voxels[None], viewport=net.config.viewport, forgiven=0)
    return {
        "image": picture.name,
        "corners_cm": np.nan if picture.markers is None else 100 * corner_error(placed, picture.markers),
        "vertices_cm": np.nan if picture.mesh is None else 100 * vertex_error(placed, picture.mesh),
        "iou": goal_iou(mesh, observation.points),
        "columns": float(agrees.silhouette[0]),
        "heights": float(agrees.heights[0]),
    }


def corner_error(placed: Float[np.ndarray, "u v 3"], markers: Float[np.ndarray, "markers 2"]) -> float:
    """Return the mean distance of markers to the corners that they are matched to at least cost [m]."""
    corners = placed[[0, 0, -1, -1], [0, -1, 0, -1], :2]
    away = np.linalg.norm(markers[:, None] - corners, axis=-1)
    return float(away[linear_sum_assignment(away)].mean())


def vertex_error(placed: Float[np.ndarray, "u v 3"], truth: Float[np.ndarray, "rows columns 3"]) -> float:
    """Return the mean distance of the mesh to the true one, at the latter's vertices and in the best labelling [m]."""
    rows, columns = truth.shape[:2]
    lines = (np.linspace(0, count - 1, n) for count, n in zip(placed.shape[:2], (rows, columns), strict=True))
    places = np.meshgrid(*lines, indexing="ij")
    own = np.stack([map_coordinates(placed[..., axis], places, order=1) for axis in range(3)], axis=-1)
    return min(float(np.linalg.norm(own - other, axis=-1).mean()) for other in np.asarray(equivalents(truth)))


def draw(path: Path, picture: Picture, observation: Observation, mesh: Float[np.ndarray, "u v 3"], title: str) -> None:
    """Draw the observed heights, the estimate and both on one another, in cm."""
    placed = 100 * observation.pose.normalised_to_table(mesh.astype(float))
    points = 100 * picture.points[:: max(1, len(picture.points) // 20_000)]
    highest = float(np.percentile(points[:, 2], 99.5))
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.4), layout="constrained")
    for axis, seen, drawn in zip(axes, (True, False, True), (False, True, True), strict=True):
        if seen:
            axis.scatter(*points[:, :2].T, c=points[:, 2], s=1, vmin=0, vmax=highest)
        if drawn:
            order = np.argsort(placed[..., 2].ravel())
            flat = placed.reshape(-1, 3)[order]
            if not seen:
                axis.scatter(*flat[:, :2].T, c=flat[:, 2], s=12, vmin=0, vmax=highest)
            for line in (*placed[::2], *placed.transpose(1, 0, 2)[::2]):
                axis.plot(line[:, 0], line[:, 1], color="black", linewidth=0.5)
        if picture.markers is not None:
            axis.plot(*(100 * picture.markers.T), "r+", markersize=10)
        axis.set(aspect="equal", xlim=(-19, 19), ylim=(-19, 19))
    figure.suptitle(title)
    figure.savefig(path, dpi=60)
    plt.close(figure)


def nets(
    data: Path, seeds: list[int], ways: list[str], also: Path | None, params: Params
) -> Iterator[tuple[str, int, Path, Net]]:
    """The net of the chain and those with other seeds or trained in other ways, each with way, seed and folder."""
    own = params.stages.train_vtm.training.seed
    yield CHAIN, own, data / "nets/vtm", store.load(data / "nets/vtm")
    for way, seed in [*((CHAIN, seed) for seed in seeds if seed != own), *((way, own) for way in ways)]:
        used = [data / "meshes.zarr", *([also / "meshes.zarr"] if also and way == MORE else [])]
        varied = params if way == CHAIN else with_training(params, WAYS[way](params.stages.train_vtm))
        sets = [load(path) for path in used]
        training = joined([dataset.of_split("train") for dataset in sets])
        folder = data / "studies/real_cloths" / (str(seed) if way == CHAIN else way.replace(" ", "_"))
        current = fingerprint(used, varied.stages.train_vtm)
        net = train_estimator(folder, seed, varied, training, sets[0].of_split("validation"), current)
        yield way, seed, folder, net


def with_training(params: Params, training: TrainVtMConfig) -> Params:
    """Return params with other settings of the stage train_vtm."""
    stages = params.stages.model_copy(update={"train_vtm": training})
    return params.model_copy(update={"scales": {**params.scales, params.scale: stages}})


def joined(datasets: list[Dataset]) -> Dataset:
    """Return the sequences of several datasets."""
    names = [field.name for field in dataclasses.fields(Dataset)]
    return Dataset(*(np.concatenate([getattr(dataset, name) for dataset in datasets]) for name in names))


def main() -> None:
    """Run the study and print the means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--seeds", type=int, nargs="*", default=[])
    parser.add_argument("--ways", choices=list(WAYS), nargs="*", default=[])
    parser.add_argument("--also", type=Path, metavar="FOLDER")
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    if (MORE in asked.ways) != (asked.also is not None):
        parser.error(f"--ways {MORE!r} and --also FOLDER: expected both or neither")
    params = load_params(Path("params.yaml"))
    if asked.pictures:
        asked.pictures.mkdir(parents=True, exist_ok=True)
    rows = []
    for way, seed, where, net in nets(asked.data, asked.seeds, asked.ways, asked.also, params):
        settings = dataclasses.replace(params.app.cloud, viewport=net.config.viewport)
        made = fingerprint([where], settings, params.stages.plan.refine)
        for picture in pictures(asked.folder):
            observation = observed(picture, settings)
            mesh = estimated(picture, observation, net, params.stages.plan.refine)
            rows.append({"way": way, "seed": seed, **row_of(picture, observation, mesh, net), COLUMN: made})
            if asked.pictures:
                measured = {name: value for name, value in rows[-1].items() if isinstance(value, float)}
                told = ", ".join(f"{name} {value:.2f}" for name, value in measured.items() if np.isfinite(value))
                path = asked.pictures / f"{picture.name}_{way}_{seed}.png"
                draw(path, picture, observation, mesh, f"{picture.name}: {told}")
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "real_cloths.csv"
    kept = [pd.read_csv(file)] if file.exists() else []
    found = pd.concat([*kept, pd.DataFrame(rows)]).drop_duplicates(KEYS, keep="last").round(4)
    kind = found["image"].str.replace(r"_\d+$", "", regex=True).rename("kind")
    means = found.drop(columns=["image", COLUMN]).groupby([kind, "way", "seed"], sort=False).mean().round(3)
    print(means.to_string())
    found.to_csv(file, index=False)
    means.reset_index().to_csv(folder / "real_cloths_summary.csv", index=False)


if __name__ == "__main__":
    main()

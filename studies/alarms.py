"""Is what the nets do not know noticed?  python studies/alarms.py [STATES] [options]

Shows scenes to the net as points from above, estimates them as `clothkit estimate` does, and counts the alarms that
the nets' alarms.npz raises (stage set_alarms). STATES test states (default: 60) are each shown in every scene:

known               the state as it is: every alarm is a false one
known, CONDITION    the same as exact voxels, and before each depth camera of the param set_alarms.conditions
T-shirt             instead of the cloth, a T-shirt of its size, flat or folded once
two cloths          beside and partly on the cloth another state
hand                a hand and its arm reach in, 3 to 8 cm above the table, over the cloth or beside it
thicker             all heights times 3, of a cloth whose thickness is told as it was; only cloths that become thicker
                    than any that the nets know
thicker, told       the same, of cloths whose thickness is told as what it is

A row per scene and state goes to reports/<scale>/studies/alarms.csv: agreement of silhouettes and of heights,
strangeness, whether the cloth is known, and whether an alarm is raised. The shares of alarms, with 95 % Wilson
intervals, are printed and go to alarms_summary.csv. The nets and data are those in `--data` (default: data). With
`--seed N`, the states are of sequences that are simulated for this with that seed, so that no choice has seen them;
then no data are needed, prebuilt nets will do (`--data prebuilt/household`), and the files have the seed in their
names. With `--pictures FILE`, voxels and estimates of the first states are drawn.
"""

import argparse
import dataclasses
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import matplotlib
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from towel import params_of, unpacked_nets

from clothkit.cloth import voxels
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset import store
from clothkit.dataset.regularise import RegulariseConfig, regularise
from clothkit.dataset.store import STATES, Dataset
from clothkit.estimation.alarms import Alarms, load, signs
from clothkit.estimation.estimate import estimate
from clothkit.evaluation.camera import NO_CAMERA, observe
from clothkit.models import store as nets
from clothkit.models.net import Net
from clothkit.observation.coverage import centre
from clothkit.params import Params
from clothkit.planning.batches import in_batches
from clothkit.runtime.errors import InputError
from clothkit.runtime.stage import Stage
from clothkit.simulation.generation import generate
from clothkit.simulation.settings import SimulateConfig

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Points = Float[np.ndarray, "points 3"]
STEP = 0.02
"""Distance of the points of a T-shirt and of a hand [normalised]."""
THICKER = 3.0
METRE = CLOTH_LENGTH / 0.4
"""Normalised units a metre, for a cloth of 0.4 m."""
BATCH = 20
WORK = Path(".work/studies/alarms")


def grid(low: float, high: float) -> Float[np.ndarray, "points 2"]:
    """Return a regular grid over a square."""
    axis = np.arange(low, high, STEP)
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


def turned(points: Points, angle: float) -> Points:
    """Return the points, turned about z."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def of_mesh(mesh: Float[np.ndarray, "u v 3"]) -> Points:
    """Return the points of a mesh."""
    return np.asarray(voxels.double(mesh), float).reshape(-1, 3)


def t_shirt(thickness: float, rng: np.random.Generator) -> Points:
    """Return a T-shirt, 0.75 of a cloth's side long, flat or with one side folded over."""
    xy = grid(-0.8, 0.8)
    x, y = np.abs(xy[:, 0]), xy[:, 1]
    body, sleeves = (x < 0.36) & (np.abs(y) < 0.52), (y > 0.2 + 0.3 * (x - 0.36)) & (y < 0.52 - 0.25 * x) & (x < 0.7)
    neck = (x / 0.15) ** 2 + ((y - 0.52) / 0.1) ** 2 < 1
    xy = xy[(body | sleeves) & ~neck]
    layers = np.full(len(xy), 2.0)  # Front and back.
    if rng.random() < 0.5:
        line = rng.uniform(-0.1, 0.3)
        over = xy[:, 0] > line
        xy[over, 0] = 2 * line - xy[over, 0]
        layers[over] = 4.0
    return turned(np.column_stack([xy, thickness * layers]), rng.uniform(0, 2 * np.pi))


def hand(mesh: Points, rng: np.random.Generator) -> Points:
    """Return a hand and an arm that reach in from a side to a point on the cloth or near it."""
    tip = mesh[rng.integers(len(mesh)), :2] + rng.normal(0, 0.15, 2)
    along = np.arange(0, 3, STEP)
    width = np.where(along < 0.18 * METRE, 0.045, 0.035) * METRE
    height = rng.uniform(0.03, 0.08) * METRE
    across = np.arange(-0.05 * METRE, 0.05 * METRE, STEP)
    x, y = np.meshgrid(along, across, indexing="ij")
    inside = np.abs(y) < width[:, None]
    z = height * np.sqrt(1 - (y / (1.2 * width[:, None])) ** 2, where=inside, out=np.zeros_like(y))
    arm = np.column_stack([x[inside], y[inside], z[inside]])
    return turned(arm, rng.uniform(0, 2 * np.pi)) + np.array([*tip, 0])


Scene = Callable[[int, np.random.Generator], tuple[Points, Float[np.ndarray, "3"]]]


class Shown(NamedTuple):
    """What the net sees of a scene, once per state, what it is told of the cloths, and its estimates."""

    state: Int[np.ndarray, " shown"]
    voxels: Bool[np.ndarray, "shown x y z"]
    cloth: Float[np.ndarray, "shown 3"]
    mesh: Float[np.ndarray, "shown u v 3"]


def scenes(truth: Float[np.ndarray, "states u v 3"], cloth: Float[np.ndarray, "states 3"]) -> dict[str, Scene]:
    """Return, per scene, the function from a state's number to points and what is told of the cloth."""

    def two(i: int, rng: np.random.Generator) -> Points:
        other = turned(of_mesh(truth[rng.integers(len(truth))]), rng.uniform(0, 2 * np.pi))
        away = rng.uniform(0.4, 1.0) * np.array([*np.array([[1, 0], [0, 1]])[rng.integers(2)], 0])
        return np.concatenate([of_mesh(truth[i]), other + away])

    thicker = np.array([1, 1, THICKER])
    return {
        "known": lambda i, rng: (of_mesh(truth[i]), cloth[i]),
        "T-shirt": lambda i, rng: (t_shirt(float(cloth[i, 2]), rng), cloth[i]),
        "two cloths": lambda i, rng: (two(i, rng), cloth[i]),
        "hand": lambda i, rng: (np.concatenate([of_mesh(truth[i]), hand(of_mesh(truth[i]), rng)]), cloth[i]),
        "thicker": lambda i, rng: (of_mesh(truth[i]) * thicker, cloth[i]),
        "thicker, told": lambda i, rng: (of_mesh(truth[i]) * thicker, cloth[i] * thicker),
    }


def seen(points: Points, viewport: voxels.Viewport) -> Bool[np.ndarray, "x y z"]:
    """Return the occluded voxels of points about their centre, as a camera above shows them."""
    points = points - [*centre(points[:, :2], extent=4.0), 0]
    inside = points[np.abs(points[:, :2]).max(axis=1) < 1]
    return np.asarray(voxels.occlude(voxels.voxelise(inside.astype(np.float32), viewport=viewport)))


def chosen(dataset: Dataset, count: int) -> tuple[Float[np.ndarray, "states u v 3"], Float[np.ndarray, "states 3"]]:
    """Return the first test states that a manipulation has left, and their cloths."""
    test = dataset.of_split("test")
    row, state = np.nonzero((np.arange(STATES) <= test.length[:, None]) & (np.arange(STATES) > 0))
    return test.vertices[row, state][:count], test.cloth[row][:count]


def simulated(settings: SimulateConfig, states: int, seed: int) -> Dataset:
    """Return a dataset whose test split has that many states, of sequences that are simulated with a seed.

    Finished blocks of sequences are kept under WORK, and an interrupted call goes on from them.
    """
    longest = STATES - 1
    splits = RegulariseConfig(train=1, validation=1, test=-(-states // longest))
    sequences = splits.train + splits.validation + splits.test
    asked = dataclasses.replace(settings, sequences=sequences, seed=seed)
    work = Stage.pieces(WORK, asked.decisive)
    work.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        print(generate(Path(folder) / "raw", asked, work=work, attributes={}))
        return regularise(Path(folder) / "raw", splits)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a share."""
    z, share = 1.96, hits / count
    middle, wide = share + z**2 / (2 * count), z * np.sqrt(share * (1 - share) / count + (z / count) ** 2 / 4)
    return (middle - wide) / (1 + z**2 / count), (middle + wide) / (1 + z**2 / count)


def summary(table: pd.DataFrame, alarms: Alarms) -> pd.DataFrame:
    """Return the shares of alarms by scene, of all signs and of each alone."""
    each = {
        "silhouette": table["silhouette"] < alarms.least.silhouette,
        "heights": table["heights"] < alarms.least.heights,
        "strange": table["strangeness"] > alarms.strangest,
        "unknown cloth": ~table["known_cloth"],
    }
    table = table.assign(**each)
    rows = []
    for scene, own in table.groupby("scene", sort=False):
        low, high = wilson(int(own["alarm"].sum()), len(own))
        rows.append({"scene": scene, "states": len(own), "noticed": own["alarm"].mean(), "low": low, "high": high})
        rows[-1] |= {name: own[name].mean() for name in each}
    return pd.DataFrame(rows)


def draw(path: Path, shown: dict[str, tuple[np.ndarray, np.ndarray]], count: int = 6) -> None:
    """Draw the heights that are seen and the estimates' vertices, a row per scene."""
    figure, axes = plt.subplots(len(shown), count, figsize=(2 * count, 2 * len(shown)), squeeze=False)
    for row, (scene, (occupied, mesh)) in zip(axes, shown.items(), strict=True):
        for axis, of, vertices in zip(row, occupied, mesh, strict=False):
            axis.imshow(of.sum(-1).T, origin="lower", extent=(-1, 1, -1, 1), cmap="Greys", vmin=0, vmax=16)
            axis.plot(*vertices.reshape(-1, 3)[:, :2].T, ".", ms=1, color="C0")
            axis.set(xticks=[], yticks=[])
        row[0].set_ylabel(scene)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def shown_scenes(
    net: Net,
    params: Params,
    alarms: Alarms,
    truth: Float[np.ndarray, "states u v 3"],
    cloths: Float[np.ndarray, "states 3"],
) -> Iterator[tuple[str, Shown]]:
    """Yield each scene's name, and the scene as the net sees it."""
    stages = params.stages
    every = np.arange(len(truth))

    def estimated(occupied: np.ndarray, cloth: np.ndarray) -> jax.Array:
        return estimate(net, occupied, stages.plan.refine, cloth=cloth).mesh

    beyond = ~alarms.knows(cloths * [1, 1, THICKER])
    for number, (scene, show) in enumerate(scenes(truth, cloths).items()):
        states = every[beyond] if scene.startswith("thicker") else every
        given = [show(i, np.random.default_rng([number, i])) for i in states.tolist()]
        if given:
            occupied = np.stack([seen(points, net.config.viewport) for points, _ in given])
            told = np.stack([cloth for _, cloth in given]).astype(np.float32)
            yield scene, Shown(states, occupied, told, in_batches(estimated, BATCH, occupied, told))
    for condition in (NO_CAMERA, *stages.set_alarms.conditions):
        found = observe(truth, cloths, net, condition, stages.evaluate_camera, stages.plan.refine, stored=[])
        there = np.flatnonzero(found.voxels.any((1, 2, 3)))
        yield f"known, {condition.name}", Shown(there, found.voxels[there], cloths[there], found.mesh[there])


def main() -> None:
    """Run the study, and write and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("states", type=int, nargs="?", default=60)
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--seed", type=int)
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    data = unpacked_nets(asked.data)
    params = params_of(data)
    net = nets.load(data / "nets/vtm", "vtm")
    alarms = load(data / "nets/alarms.npz", units=net.config.hidden)
    if asked.seed is None:
        dataset = store.load(data / "meshes.zarr")
    else:
        dataset = simulated(params.stages.simulate, asked.states, asked.seed)
    truth, cloths = chosen(dataset, asked.states)
    rows, pictures = [], {}
    for scene, shown in shown_scenes(net, params, alarms, truth, cloths):
        found = signs(net, alarms.support, shown.voxels, shown.mesh, shown.cloth)
        known = alarms.knows(shown.cloth)
        columns = {"scene": scene, "state": shown.state, "silhouette": found.agreement.silhouette}
        columns |= {"heights": found.agreement.heights, "strangeness": found.strangeness, "known_cloth": known}
        rows.append(pd.DataFrame(columns | {"alarm": alarms.raised(found) | ~known}))
        pictures[scene] = (shown.voxels, shown.mesh)
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    table = pd.concat(rows, ignore_index=True)
    shares = summary(table, alarms)
    of = "" if asked.seed is None else f"_seed_{asked.seed}"
    table.round(4).to_csv(folder / f"alarms{of}.csv", index=False, lineterminator="\n")
    shares.round(3).to_csv(folder / f"alarms_summary{of}.csv", index=False, lineterminator="\n")
    print(shares.round(2).to_string(index=False))
    if asked.pictures:
        draw(asked.pictures, pictures)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"alarms: {error}") from error

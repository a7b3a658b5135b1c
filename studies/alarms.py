"""Is what the nets do not know noticed?  python studies/alarms.py [STATES] [options]

Shows scenes to the net as points from above, estimates them as `clothkit estimate` does, and counts the alarms that
data/nets/alarms.npz raises (stage set_alarms). STATES test states (default: 60) are each shown in every scene:

known               the state as it is: every alarm is a false one
T-shirt             instead of the cloth, a T-shirt of its size, flat or folded once
two cloths          beside and partly on the cloth another state
hand                a hand and its arm reach in, 3 to 8 cm above the table, over the cloth or beside it
thicker             all heights times 3, of a cloth whose thickness is told as it was
thicker, told       all heights times 3, of a cloth whose thickness is told as what it is

A row per scene and state goes to reports/<scale>/studies/alarms.csv: agreement of silhouettes and of heights,
strangeness, whether the cloth is known, and whether an alarm is raised. The shares of alarms, with 95 % Wilson
intervals, are printed and go to alarms_summary.csv. The nets and data are those in `--data` (default: data). With
`--pictures FILE`, voxels and estimates of the first states are drawn.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import jax
import matplotlib
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from clothkit.cloth import voxels
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset import store
from clothkit.dataset.store import STATES, Dataset
from clothkit.estimation.alarms import Alarms, load, signs
from clothkit.estimation.estimate import estimate
from clothkit.models import store as nets
from clothkit.observation.coverage import centre
from clothkit.params import load_params
from clothkit.planning.batches import in_batches

matplotlib.use("Agg")
import matplotlib.pyplot as plt

Points = Float[np.ndarray, "points 3"]
STEP = 0.02
"""Distance of the points of a T-shirt and of a hand [normalised]."""
THICKER = 3.0
METRE = CLOTH_LENGTH / 0.4
"""Normalised units a metre, for a cloth of 0.4 m."""
BATCH = 20


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


def main() -> None:
    """Run the study, and write and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("states", type=int, nargs="?", default=60)
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    net = nets.load(asked.data / "nets/vtm", "vtm")
    alarms = load(asked.data / "nets/alarms.npz", units=net.config.hidden)
    truth, cloths = chosen(store.load(asked.data / "meshes.zarr"), asked.states)
    refine, rows, shown = params.stages.plan.refine, [], {}

    def estimated(occupied: np.ndarray, cloth: np.ndarray) -> jax.Array:
        return estimate(net, occupied, refine, cloth=cloth).mesh

    for number, (scene, show) in enumerate(scenes(truth, cloths).items()):
        given = [show(i, np.random.default_rng([number, i])) for i in range(len(truth))]
        occupied = np.stack([seen(points, net.config.viewport) for points, _ in given])
        told = np.stack([cloth for _, cloth in given]).astype(np.float32)
        mesh = in_batches(estimated, BATCH, occupied, told)
        found = signs(net, alarms.support, occupied, mesh, told)
        known = alarms.knows(told)
        columns = {"scene": scene, "state": np.arange(len(truth)), "silhouette": found.agreement.silhouette}
        columns |= {"heights": found.agreement.heights, "strangeness": found.strangeness, "known_cloth": known}
        rows.append(pd.DataFrame(columns | {"alarm": alarms.raised(found) | ~known}))
        shown[scene] = (occupied, mesh)
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    table = pd.concat(rows, ignore_index=True)
    shares = summary(table, alarms)
    table.round(4).to_csv(folder / "alarms.csv", index=False, lineterminator="\n")
    shares.round(3).to_csv(folder / "alarms_summary.csv", index=False, lineterminator="\n")
    print(shares.round(2).to_string(index=False))
    if asked.pictures:
        draw(asked.pictures, shown)


if __name__ == "__main__":
    main()

"""ARCSim's runs as raw artifacts, the same that our solver writes (design section 4).

A topology per state, since remeshing changes nodes and triangles from frame to frame. States are recorded as they are:
no limit of acceptance applies to them, and the quality columns tell what they are like.
"""

import os
import shutil
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float
from tqdm import tqdm

from clothkit.cloth.grid import CLOTH_SIDE
from clothkit.errors import InputError
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import SHORTEST
from clothkit.simulation.arcsim_obj import Frame, read_frame
from clothkit.simulation.arcsim_runs import Run, Sequence
from clothkit.simulation.arcsim_scene import Handle, read_scene
from clothkit.simulation.quality import pierced
from clothkit.simulation.records import SCHEMAS, SHARD, write_tables

BLOCK = 20  # sequences in a resumable piece
NO_SEED = -1  # nothing was drawn
NOT_COUNTED = -1  # creases are counted on grids

TOLERANCE = 0.1
"""How far from its mirror image, eq. (1), a hand may let go, as a share of the cloth's side."""


class Manipulation(NamedTuple):
    """What the hands of a run did."""

    grasps: Float[np.ndarray, "hands 2"]
    """Geodesic."""
    displacement: Float[np.ndarray, "2"]
    """Normalised."""
    releases: Float[np.ndarray, "hands 2"]
    """Metres."""
    released: float
    """s, into the run."""


class Summary(NamedTuple):
    """What was imported."""

    sequences: int
    manipulations: int
    single: int
    short: int

    def __str__(self) -> str:
        """One sentence."""
        short = f"; {self.short} are shorter than what counts as a manipulation" if self.short else ""
        return (
            f"{self.sequences} sequences of ARCSim with {self.manipulations} manipulations, "
            f"{self.single} of them single-handed{short}"
        )


def import_runs(folder: Path, sequences: list[Sequence], *, work: Path, attributes: dict[str, Any]) -> Summary:
    """Write the raw artifacts of sequences of ARCSim under `folder`, and return what there was.

    Sequences keep the numbers that the table gives them. Finished blocks lie in `work`; an interrupted import goes on
    from them. Raises InputError for files that are no cloth, and for hands that do what no manipulation does.
    """
    first = 0
    blocks = []
    with tqdm(total=len(sequences), desc="import", unit="sequence", mininterval=1, smoothing=0.05) as bar:
        for number, start in enumerate(range(0, len(sequences), BLOCK)):
            part = sequences[start : start + BLOCK]
            blocks.append(_block(work / f"runs_{number:05d}", part, partial(_tables, part, start, first)))
            first += sum(len(sequence) for sequence in part)
            bar.update(len(part))
    tables = {name: pa.concat_tables([block[name] for block in blocks]) for name in SCHEMAS}
    lengths = np.array([len(sequence) for sequence in sequences])
    ends = np.append(np.cumsum(lengths)[SHARD - 1 :: SHARD], lengths.sum())
    bounds = np.unique(np.append(0, ends))
    states = tables.pop("states")
    shards = (states.slice(first, last - first) for first, last in pairwise(bounds.tolist()))
    write_tables(folder, shards, tables, attributes)
    found = tables["manipulations"]
    short = np.hypot(found["dx"].to_numpy(), found["dy"].to_numpy()) < SHORTEST
    single = found["hands"].to_numpy() == 1
    return Summary(len(sequences), found.num_rows, int(single.sum()), int(short.sum()))


def _block(path: Path, sequences: list[Sequence], make: Callable[[], dict[str, pa.Table]]) -> dict[str, pa.Table]:
    """A block's tables, from its folder if an earlier run has finished it; the folder appears only when it is whole."""
    if not path.exists():
        unfinished = path.with_suffix(".part")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        for name, table in make().items():
            pq.write_table(table, unfinished / f"{name}.parquet")
        os.replace(unfinished, path)
    return {name: pq.read_table(path / f"{name}.parquet") for name in SCHEMAS}


def _tables(sequences: list[Sequence], attempt: int, topology: int) -> dict[str, pa.Table]:
    """The tables of some sequences; `attempt` and `topology` are the numbers of their first sequence and state."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in SCHEMAS}
    for number, sequence in enumerate(sequences, attempt):
        frames = [read_frame(run.path) for run in sequence]
        for run, frame in zip(sequence, frames, strict=True):
            rows["states"].append(_state(run, frame, topology))
            rows["topologies"].append(
                {"topology": topology, "material": frame.material.ravel(), "triangles": frame.triangles.ravel()}
            )
            topology += 1
        for before, run, frame in zip(sequence, sequence[1:], frames, strict=False):
            rows["manipulations"].append({**_manipulation(before, run, frame), "seed": NO_SEED, "attempt": number})
        rows["attempts"].append(
            {
                "attempt": number,
                "seed": NO_SEED,
                "accepted": True,
                "reason": "",
                "states": len(sequence),
                "area": [np.nan] * len(sequence),
                "folds": [NOT_COUNTED] * len(sequence),
            }
        )
    return {name: pa.Table.from_pylist(found, schema=SCHEMAS[name]) for name, found in rows.items()}


def _state(run: Run, frame: Frame, topology: int) -> dict[str, Any]:
    """A row of states. The gap is missing: its two-ring has no size of its own where triangles differ in size."""
    positions = frame.positions.astype(np.float32)
    ends = np.sort(frame.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    ends = np.unique(ends, axis=0)
    length, rest = (
        np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=-1) for points in (frame.positions, frame.material)
    )
    strain = np.abs(length / rest - 1)
    return {
        "sequence": run.sequence,
        "state": run.state,
        "topology": topology,
        "vertices": positions.ravel(),
        "height": positions[:, 2].max() * CLOTH_SIDE / frame.side,
        "strain_p99": np.percentile(strain, 99),
        "strain_worst": strain.max(),
        "intersections": int(pierced(positions[None], ends, frame.triangles)[0]),
        "gap": np.nan,
        "residual_speed": np.nan if frame.speed is None else frame.speed.max(),
    }


def _manipulation(before: Run, run: Run, frame: Frame) -> dict[str, Any]:
    """A row of manipulations: what led from the state before, whose cloth is `frame`, to the run's."""
    scene, start = read_scene(run.scene), read_frame(run.start)
    goes_on = before.folder == run.folder
    # Half a frame of leeway: a hand may come back in the very step of which a frame was kept.
    since = (before.frame - 0.5) * scene.frame_time if goes_on else -np.inf
    handles = [handle for handle in scene.handles if since <= handle.start < (run.frame - 0.5) * scene.frame_time]
    if not handles:
        raise InputError(f"{run.scene}: handles: expected one that starts before frame {run.frame}, found none")
    # A run that goes on from a frame of its own grasps the nodes where they then are.
    found = manipulation(run.scene, handles, start, frame if goes_on else start)
    hands = len(found.grasps)
    both = [0, hands - 1]
    names = ("u1", "v1", "u2", "v2", "dx", "dy", "release_x1", "release_y1", "release_x2", "release_y2")
    values = [*found.grasps[both].ravel(), *found.displacement, *found.releases[both].ravel()]
    return {
        "sequence": run.sequence,
        "step": run.state - 1,
        "hands": hands,
        **dict(zip(names, values, strict=True)),
        "settle_time": run.frame * scene.frame_time - found.released,
    }


def manipulation(scene: Path, handles: list[Handle], start: Frame, before: Frame) -> Manipulation:
    """What handles do as one manipulation; `start` names their nodes, `before` is the cloth that they grasp.

    By eq. (1) hand k moves by 2 a_k d, with a_1 + a_2 = 1: the displacement d is the mean of the hands' moves. Raises
    InputError, naming the scene's file, when a hand ends more than TOLERANCE from where eq. (1) has it let go.
    """
    nodes = [handle.node for handle in handles]
    if len(nodes) > 2 or len(set(nodes)) < len(nodes):
        raise InputError(f"{scene}: handles: grasp the nodes {nodes} at once, expected one node or two, each once")
    if max(nodes) >= len(start.positions):
        count = len(start.positions)
        raise InputError(f"{scene}: handles: node {max(nodes)} is none of the {count} that the run starts with")
    # Remeshing keeps a grasped node and changes its number: its material coordinates find it again.
    away = np.linalg.norm(before.material - start.material[nodes][:, None], axis=-1)
    grasps = before.positions[away.argmin(1), :2]
    moves = np.stack([handle.move for handle in handles])
    displacement = moves.mean(0)
    expected = release_points(grasps[[0, -1]], displacement).points[: len(grasps)]
    missed = np.linalg.norm(grasps + moves - expected, axis=-1).max() / start.side
    if missed > TOLERANCE:
        raise InputError(
            f"{scene}: handles: a hand lets go {missed:.2f} cloth sides from where a manipulation's would, eq. (1), "
            f"expected at most {TOLERANCE}"
        )
    return Manipulation(
        np.stack([start.geodesic(node) for node in nodes]),
        displacement * (CLOTH_SIDE / start.side),
        grasps + moves,
        max(handle.end for handle in handles),
    )

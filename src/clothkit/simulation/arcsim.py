"""Import of ARCSim runs as raw artifacts, in the format that our solver writes (design section 4).

Each state has its own topology, since remeshing changes nodes and triangles from frame to frame. No acceptance limits
apply to the states; the quality columns hold what was measured on them.
"""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float
from tqdm import tqdm

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import SHORTEST
from clothkit.runtime.errors import InputError
from clothkit.runtime.resumable import Storage, resumable_map
from clothkit.simulation.arcsim_obj import Frame, read_frame
from clothkit.simulation.arcsim_runs import Run, Sequence
from clothkit.simulation.arcsim_scene import Handle, read_scene
from clothkit.simulation.quality import pierced
from clothkit.simulation.records import SCHEMAS, SHARD, write_tables

BLOCK = 20  # sequences in a resumable piece
NO_SEED = -1  # nothing was drawn at random
NOT_COUNTED = -1  # creases are counted on grids only

TOLERANCE = 0.1
"""Largest distance between a hand's release point and that of eq. (1), as a fraction of the cloth's side."""


class Manipulation(NamedTuple):
    """The grasps, displacement and releases of a run's hands."""

    grasps: Float[np.ndarray, "hands 2"]
    """Geodesic coordinates."""
    displacement: Float[np.ndarray, "2"]
    """Normalised."""
    releases: Float[np.ndarray, "hands 2"]
    """Metres."""
    released: float
    """Time of release, in s from the start of the run."""


class Summary(NamedTuple):
    """Counts of what was imported: sequences, manipulations, single-handed ones and ones shorter than SHORTEST."""

    sequences: int
    manipulations: int
    single: int
    short: int

    def __str__(self) -> str:
        """Return the counts as one sentence."""
        short = f"; {self.short} are shorter than what counts as a manipulation" if self.short else ""
        return (
            f"{self.sequences} sequences of ARCSim with {self.manipulations} manipulations, "
            f"{self.single} of them single-handed{short}"
        )


def import_runs(folder: Path, sequences: list[Sequence], *, work: Path, attributes: dict[str, Any]) -> Summary:
    """Write the raw artifacts of ARCSim sequences under `folder`, and return their counts.

    Sequences keep their numbers in the table. Finished blocks are stored in `work`, and an interrupted import resumes
    from them. Raises InputError for files that hold no cloth, and for hand motions that are no manipulation.
    """
    with tqdm(total=len(sequences), desc="import", unit="sequence", mininterval=1, smoothing=0.05) as bar:
        finished = resumable_map(
            _tables,
            _blocks(sequences),
            folder=work,
            name="runs",
            storage=TABLES,
            bar=bar,
            count=lambda tables: tables["attempts"].num_rows,
        )
        blocks = [block for _, block in finished]
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


class Block(NamedTuple):
    """Sequences that are imported together."""

    sequences: list[Sequence]
    attempt: int
    """Number of the first sequence."""
    topology: int
    """Number of the first state."""


def _save_tables(folder: Path, tables: dict[str, pa.Table]) -> None:
    folder.mkdir()
    for name, table in tables.items():
        pq.write_table(table, folder / f"{name}.parquet")


def _load_tables(folder: Path) -> dict[str, pa.Table]:
    return {name: pq.read_table(folder / f"{name}.parquet") for name in SCHEMAS}


TABLES = Storage(_save_tables, _load_tables)
"""Storage of a block's tables in a work directory, as a folder of parquet files."""


def _blocks(sequences: list[Sequence]) -> Iterator[Block]:
    topology = 0
    for start in range(0, len(sequences), BLOCK):
        part = sequences[start : start + BLOCK]
        yield Block(part, start, topology)
        topology += sum(len(sequence) for sequence in part)


def _tables(block: Block) -> dict[str, pa.Table]:
    """Return the tables of a block's sequences."""
    topology = block.topology
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in SCHEMAS}
    for number, sequence in enumerate(block.sequences, block.attempt):
        frames = [read_frame(run.path) for run in sequence]
        for run, frame in zip(sequence, frames, strict=True):
            rows["states"].append(_state(run, frame, topology))
            rows["topologies"].append(
                {"topology": topology, "material": frame.material.ravel(), "triangles": frame.triangles.ravel()}
            )
            topology += 1
        for before, run, frame in zip(sequence, sequence[1:], frames, strict=False):
            rows["manipulations"].append({**_manipulation(before, run, frame), "seed": NO_SEED, "attempt": number})
        sides = np.ptp(frames[0].material, axis=0)
        rows["cloths"].append(
            {
                "sequence": sequence[0].sequence,
                "start": None,
                "side_u": sides[0],
                "side_v": sides[1],
                "thickness": read_scene(sequence[0].scene).thickness,
            }
        )
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
    """Return a row of the states table, with gap NaN: the two-ring has no fixed size where triangle sizes differ."""
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
        "height": positions[:, 2].max() * CLOTH_LENGTH / frame.side,
        "strain_p99": np.percentile(strain, 99),
        "strain_worst": strain.max(),
        "intersections": int(pierced(positions[None], ends, frame.triangles)[0]),
        "gap": np.nan,
        "residual_speed": np.nan if frame.speed is None else frame.speed.max(),
    }


def _manipulation(before: Run, run: Run, frame: Frame) -> dict[str, Any]:
    """Return a row of the manipulations table: the step from `before`, whose cloth is `frame`, to the run's state."""
    scene, start = read_scene(run.scene), read_frame(run.start)
    goes_on = before.folder == run.folder
    # Half a frame of tolerance: a hand may grasp again in the very step of which a frame was kept.
    since = (before.frame - 0.5) * scene.frame_time if goes_on else -np.inf
    handles = [handle for handle in scene.handles if since <= handle.start < (run.frame - 0.5) * scene.frame_time]
    if not handles:
        raise InputError(f"{run.scene}: handles: expected one that starts before frame {run.frame}, found none")
    # A run that continues from a frame of its own grasps the nodes at their positions in that frame.
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
    """Return the handles' motion as one manipulation.

    The node numbers of the handles refer to `start`; `before` is the cloth at the time of the grasp. By eq. (1) hand k
    moves by 2 a_k d, with a_1 + a_2 = 1, so the displacement d is the mean of the hands' moves. Raises InputError,
    naming the scene's file, if the handles are not one or two different nodes of `start`, or if a hand's release point
    is more than TOLERANCE from that of eq. (1).
    """
    nodes = [handle.node for handle in handles]
    if len(nodes) > 2 or len(set(nodes)) < len(nodes):
        raise InputError(f"{scene}: handles: grasp the nodes {nodes} at once, expected one node or two, each once")
    if max(nodes) >= len(start.positions):
        count = len(start.positions)
        raise InputError(f"{scene}: handles: node {max(nodes)} is none of the {count} that the run starts with")
    # Remeshing keeps a grasped node but changes its number, so it is found by its material coordinates.
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
        displacement * (CLOTH_LENGTH / start.side),
        grasps + moves,
        max(handle.end for handle in handles),
    )

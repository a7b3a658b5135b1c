"""Reads the raw artifacts: the simulator's output before it is resampled to a grid of 32 x 32 (design section 4)."""

import dataclasses
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from clothkit.dataset.store import STATES, STEPS
from clothkit.dataset.tables import Column, Complete, Table, check, read, read_groups
from clothkit.manipulation.named_folds import GOALS
from clothkit.runtime.errors import InputError
from clothkit.simulation.settings import DRAWN, STARTS

STATE_COLUMNS = ("sequence", "state", "topology", "vertices")
MANIPULATION_COLUMNS = ("sequence", "step", "hands", "u1", "v1", "u2", "v2", "dx", "dy")
MEASURED = ("height", "strain_p99", "strain_worst", "intersections", "gap", "residual_speed")
"""Columns of measurements of states, present if the simulator measures them."""

FARTHEST = 100.0
"""Largest accepted absolute coordinate [m]."""

STRETCH = 2.0
"""Largest accepted extent of a state along an axis, as a multiple of the flat cloth's diagonal."""

_SIDES = (0.01, 20.0)
"""Accepted range of a flat cloth's sides [m]; other values are probably in another unit."""

EDGES = (0.5, 2.0)
"""Nor is the median of its edges shorter or longer than so many times that of the flat cloth's."""

_COUNTED = Column("whole numbers", 0)
_MEASURE = Column("numbers", missing=True, optional=True)
# An attempt may have ended with a state that is not finite, so its measurements may be infinite or missing.
_MEASURES = Column("lists of numbers", missing=True, infinite=True, optional=True)
# Slightly more than -1..1, because grasp points come from float32 coordinates.
_GEODESIC = Column("numbers", -1.001, 1.001)
_DISPLACEMENT = Column("numbers", -10, 10)

STATES_TABLE = Table(
    {
        "sequence": _COUNTED,
        "state": Column("whole numbers", 0, STATES - 1),
        "topology": _COUNTED,
        "vertices": Column("lists of numbers", -FARTHEST, FARTHEST),
        **dict.fromkeys(MEASURED, _MEASURE),
    },
    keys=("sequence", "state"),
)
"""Schema of one file of states: metres, world frame."""

_ALL_STATES = Table(
    STATES_TABLE.columns,
    STATES_TABLE.keys,
    complete=(
        Complete(
            ("sequence",),
            ("state",),
            lambda states: (states["state"] + 1).clip(lower=2),
            "two to four states, from 0 on and none left out",
        ),
    ),
)
"""Schema of the states of all files together, which must have every state of each sequence."""

MANIPULATIONS = Table(
    {
        "sequence": _COUNTED,
        "step": Column("whole numbers", 0, STEPS - 1),
        "hands": Column("whole numbers", 1, 2),
        **dict.fromkeys(("u1", "v1", "u2", "v2"), _GEODESIC),
        **dict.fromkeys(("dx", "dy"), _DISPLACEMENT),
        "attempt": dataclasses.replace(_COUNTED, optional=True),
        "settle_time": Column("numbers", 0, missing=True, optional=True),
    },
    keys=("sequence", "step"),
    complete=(Complete(("sequence",), ("step",), lambda moves: moves["step"] + 1, "steps from 0 on, none left out"),),
)
"""Schema of manipulations: grasp points are geodesic, displacements normalised."""

ATTEMPTS = Table(
    {
        "attempt": dataclasses.replace(_COUNTED, optional=True),
        "accepted": Column("true or false"),
        "reason": Column("text"),
        "states": Column("whole numbers", 0, STATES),
        **dict.fromkeys((*MEASURED, "area", "folds", "settle_time"), _MEASURES),
    },
    keys=("attempt",),
)

_PROPERTY = Column("numbers", 0, missing=True, optional=True)

CLOTHS = Table(
    {
        "sequence": _COUNTED,
        "start": Column("text", among=STARTS, missing=True, optional=True),
        "side_u": Column("numbers", _SIDES[0], _SIDES[1]),
        "side_v": Column("numbers", _SIDES[0], _SIDES[1]),
        **dict.fromkeys(DRAWN, _PROPERTY),
        "goal": Column("text", among=tuple(GOALS), missing=True, optional=True),
    },
    keys=("sequence",),
)
"""Schema of cloths, in SI units; properties are missing where a simulator does not tell them."""

TOPOLOGIES = Table(
    {
        "topology": _COUNTED,
        "material": Column("lists of numbers", -FARTHEST, FARTHEST),
        "triangles": Column("lists of whole numbers", 0),
    },
    keys=("topology",),
)
"""Schema of topologies: material coordinates in metres."""


def state_files(folder: Path) -> list[Path]:
    """The parquet files of states in a folder, sorted. Raises InputError if there are none."""
    files = sorted(folder.glob("*.parquet"))
    if not files:
        raise InputError(f"{folder}: holds no parquet file of states")
    return files


def read_states(
    folder: Path, columns: Sequence[str] = STATE_COLUMNS, *, sequences: Collection[int] | None = None
) -> pd.DataFrame:
    """Read all states, or those of some sequences, sorted by sequence and state.

    Raises InputError for a file that does not match its schema, and for a sequence with missing or duplicate states.
    """
    found = [read(file, STATES_TABLE, columns, sequences=sequences) for file in state_files(folder)]
    states = pd.concat(found).sort_values(["sequence", "state"], kind="stable").reset_index(drop=True)
    check(folder, _ALL_STATES, states)
    return states


class StateFiles:
    """The states of a folder of raw artifacts, read for some sequences at a time, since all may not fit into memory.

    Raises InputError for a file that does not match its schema, and for a sequence with missing or duplicate states; a
    fault of the vertices is told when they are read.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        found = {file: read(file, STATES_TABLE, ("sequence", "state")) for file in state_files(folder)}
        self._spans = {file: (rows["sequence"].min(), rows["sequence"].max()) for file, rows in found.items()}
        states = pd.concat(found.values()).sort_values(["sequence", "state"], kind="stable").reset_index(drop=True)
        check(folder, _ALL_STATES, states)
        self.index = states
        """Sequence and number of each state, sorted."""

    def read(self, sequences: Collection[int]) -> pd.DataFrame:
        """The STATE_COLUMNS of these sequences, sorted by sequence and state; only the files that may have them are
        opened."""
        least, most = min(sequences), max(sequences)
        files = [file for file, (first, last) in self._spans.items() if first <= most and last >= least]
        found = [read(file, STATES_TABLE, STATE_COLUMNS, sequences=sequences) for file in files]
        return pd.concat(found).sort_values(["sequence", "state"], kind="stable").reset_index(drop=True)


def read_manipulations(raw: Path, states: pd.DataFrame, columns: Sequence[str] = MANIPULATION_COLUMNS) -> pd.DataFrame:
    """Read the manipulations of a folder of raw artifacts, sorted by sequence and step.

    Raises InputError for a file that does not match its schema, and if a sequence does not have one manipulation from
    each of its `states` to the next.
    """
    path = raw / "manipulations.parquet"
    moves = read(path, MANIPULATIONS, columns).sort_values(["sequence", "step"], kind="stable").reset_index(drop=True)
    steps, reached = moves.groupby("sequence").size(), states.groupby("sequence").size() - 1
    steps, reached = steps.align(reached, fill_value=0)
    differ = steps != reached
    if differ.any():
        sequence = differ.index[differ.to_numpy()][0]
        raise InputError(
            f"{path}: sequence {sequence}: expected a manipulation from each state to the next, {reached[sequence]} of "
            f"them, found {steps[sequence]}"
        )
    return moves


def read_cloths(raw: Path, sequences: Collection[int]) -> pd.DataFrame:
    """Read the rows of these sequences' cloths, in their order.

    Raises InputError for a file that does not match its schema, and if a sequence has no row.
    """
    path = raw / "cloths.parquet"
    cloths = read(path, CLOTHS, tuple(CLOTHS.columns)).set_index("sequence")
    cloths = cloths.reindex(columns=[name for name in CLOTHS.columns if name != "sequence"])
    missing = sorted(set(sequences) - set(cloths.index))
    if missing:
        raise InputError(f"{path}: has no row for sequence {missing[0]}, expected one for each")
    return cloths.loc[list(sequences)]


class Triangulation(NamedTuple):
    """A triangulation of the cloth, shared by states."""

    material: Float[np.ndarray, "vertices 2"]
    """Position of each vertex on the flat cloth [m]."""
    triangles: Int[np.ndarray, "triangles 3"]


class Topologies:
    """The triangulations in a folder of raw artifacts. Raises InputError if the file does not match its schema."""

    def __init__(self, raw: Path) -> None:
        self.path = raw / "topologies.parquet"
        shared: dict[bytes, np.ndarray] = {}
        rows = pd.concat([_alike(part, shared) for part in read_groups(self.path, TOPOLOGIES)])
        check(self.path, TOPOLOGIES, rows)
        self.rows = rows.set_index("topology")

    def __call__(self, where: str, number: int, vertices: np.ndarray) -> tuple[Triangulation, np.ndarray]:
        """The topology of that number, and a state's flat list of coordinates as an array, float32 [vertices 3].

        Raises InputError, which names the state by `where`, if there is no such topology, if the state has another
        number of vertices, or if its extent is larger than STRETCH allows.
        """
        if number not in self.rows.index:
            raise InputError(f"{where}: its topology {number} is not in topologies.parquet")
        topology = self._topology(number)
        if len(vertices) != 3 * len(topology.material):
            raise InputError(
                f"{where}: has {len(vertices)} coordinates of vertices, expected x y z of each of the "
                f"{len(topology.material)} of its topology {number}"
            )
        positions = np.asarray(vertices, np.float32).reshape(-1, 3)
        reach, most = np.ptp(positions, axis=0).max(), STRETCH * float(np.hypot(*np.ptp(topology.material, axis=0)))
        if reach > most:
            raise InputError(f"{where}: vertices lie {reach:.3g} m apart, expected at most {most:.3g} m (in metres?)")
        length, rest = (_edge_length(points, topology.triangles) for points in (positions, topology.material))
        if not EDGES[0] <= length / rest <= EDGES[1]:
            raise InputError(
                f"{where}: edges are {length:.3g} m long (their median), expected about {rest:.3g} m, as in topology "
                f"{number} (in metres?)"
            )
        return topology, positions

    def _topology(self, number: int) -> Triangulation:
        name = f"{self.path}: topology {number}"
        material = np.asarray(self.rows.at[number, "material"], float)
        triangles = np.asarray(self.rows.at[number, "triangles"], np.int64)
        if len(material) % 2 or len(material) < 6:
            raise InputError(f"{name}: material has {len(material)} coordinates, expected x y of each vertex")
        if len(triangles) % 3 or not len(triangles) or triangles.max() >= len(material) // 2:
            raise InputError(f"{name}: triangles: expected three numbers of vertices each, below {len(material) // 2}")
        sides = np.ptp(material.reshape(-1, 2), axis=0)
        if sides.min() < _SIDES[0] or sides.max() > _SIDES[1]:
            raise InputError(
                f"{name}: material spans {sides[0]:.3g} x {sides[1]:.3g}, expected {_SIDES[0]:g} to {_SIDES[1]:g} m"
            )
        return Triangulation(material.reshape(-1, 2), triangles.astype(np.int32).reshape(-1, 3))


def _alike(rows: pd.DataFrame, shared: dict[bytes, np.ndarray]) -> pd.DataFrame:
    """Rows whose equal lists of triangles are one array: there may be a million rectangles, all of one grid."""
    kept = [shared.setdefault(own.tobytes(), own.copy()) for own in rows["triangles"]]
    return rows.assign(triangles=pd.Series(kept, index=rows.index, dtype=object))


def _edge_length(points: Float[np.ndarray, "vertices axes"], triangles: Int[np.ndarray, "triangles 3"]) -> float:
    """The median over triangles of one of their edges."""
    return float(np.median(np.linalg.norm(points[triangles[:, 1]] - points[triangles[:, 0]], axis=-1)))

"""Reads the raw artifacts as tidy rows: a row per accepted state and per tried state, with all that was measured.

Values that a file lacks are NaN; artifacts of another simulator lack many.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from jaxtyping import Float

from clothkit.cloth.silhouette import centred
from clothkit.dataset.raw import (
    ATTEMPTS,
    MANIPULATION_COLUMNS,
    MEASURED,
    STATE_COLUMNS,
    Topologies,
    read_manipulations,
    read_states,
    state_files,
)
from clothkit.dataset.regularise import Mesher
from clothkit.dataset.tables import read as read_table
from clothkit.dataset.tables import read_attributes

SHAPES = ("area", "folds")
_ATTEMPTS = ("accepted", "reason", "states")

_SOURCE = ("source", "runs")

PARTS = ("states", "manipulations.parquet", "attempts.parquet", "topologies.parquet", "cloths.parquet")


@dataclass(frozen=True)
class Inputs:
    """All inputs of the card."""

    attributes: Mapping[str, Any]
    """The attributes of the states' files, which say how they were made."""
    columns: Mapping[str, Sequence[tuple[str, str]]]
    """Names and types of every file's columns."""
    states: pd.DataFrame
    """A row per accepted state: sequence, state, topology, MEASURED, SHAPES, settle_time and length (displacement).

    Settle time and length are those of the manipulation that led to the state.
    """
    tried: pd.DataFrame
    """A row per tried state: attempt, state, accepted (the whole sequence), MEASURED, SHAPES and settle_time."""
    attempts: pd.DataFrame
    """A row per tried sequence: accepted, reason, states."""
    manipulations: pd.DataFrame
    vertices: Mapping[int, int]
    """Number of vertices of each topology."""
    sides: tuple[float, float]
    """Longer sides of the smallest and the largest flat cloth [m]."""

    @property
    def params(self) -> Mapping[str, Any]:
        """The settings among the attributes; all attributes if another program wrote the files.

        For states from another simulator, the settings of our own solver are left out, because it was not used.
        """
        stated = self.attributes.get("params", self.attributes)
        elsewhere = stated.get("source", "own") != "own"
        return {key: value for key, value in stated.items() if (key in _SOURCE) == elsewhere or key == "sequences"}


@dataclass(frozen=True)
class Example:
    """Meshes of one sequence, regularised and centred [normalised], with the manipulations between them."""

    sequence: int
    meshes: Sequence[Float[np.ndarray, "u v 3"]]
    manipulations: Sequence[Float[np.ndarray, "6"]]


def read(raw: Path) -> Inputs:
    """The card's inputs from a folder of raw artifacts. Raises InputError for missing or malformed files."""
    files = state_files(raw / "states")
    states = read_states(raw / "states", ("sequence", "state", "topology", *MEASURED))
    moves = read_manipulations(raw, states, (*MANIPULATION_COLUMNS, "attempt", "settle_time"))
    lists = (*MEASURED, *SHAPES, "settle_time")
    attempts = read_table(raw / "attempts.parquet", ATTEMPTS, (*_ATTEMPTS, "attempt", *lists))
    if "attempt" not in attempts:
        attempts["attempt"] = np.arange(len(attempts))
    tried = _tried(attempts, [name for name in lists if name in attempts])
    topologies = Topologies(raw).rows
    return Inputs(
        attributes=read_attributes(files[0]),
        columns={part: _columns(files[0] if part == "states" else raw / part) for part in PARTS},
        states=_of_states(states, moves, tried),
        tried=tried,
        attempts=attempts[["attempt", *_ATTEMPTS]],
        manipulations=moves,
        sides=_sides(topologies["material"]),
        vertices={int(n): len(m) // 2 for n, m in zip(topologies.index, topologies["material"], strict=True)},
    )


def examples(raw: Path, sequences: Sequence[int], moves: pd.DataFrame) -> list[Example]:
    """The meshes and manipulations of the given sequences, in their order. `moves` are the rows of manipulations."""
    states, mesher = read_states(raw / "states", sequences=sequences), Mesher(Topologies(raw))
    meshes: dict[int, list[np.ndarray]] = {}
    for sequence, state, topology, vertices in zip(*(states[name] for name in STATE_COLUMNS), strict=True):
        mesh = mesher(f"{raw}: sequence {sequence}, state {state}", topology, vertices)
        meshes.setdefault(int(sequence), []).append(centred(mesh)[0])
    examples = []
    for sequence in sequences:
        own = moves.loc[moves["sequence"] == sequence, ["u1", "v1", "u2", "v2", "dx", "dy"]].to_numpy(np.float32)
        examples.append(Example(int(sequence), meshes[int(sequence)], list(own)))
    return examples


def _of_states(states: pd.DataFrame, moves: pd.DataFrame, tried: pd.DataFrame) -> pd.DataFrame:
    """The states with settle time and length of the manipulation before, and SHAPES from the row of the attempt."""
    states = states.reindex(columns=["sequence", "state", "topology", *MEASURED])
    # The length is that of the displacement, because a manipulation with a too short displacement is a null one.
    led = moves.assign(state=moves["step"] + 1, length=np.hypot(moves["dx"], moves["dy"]))
    led = led.reindex(columns=["sequence", "state", "settle_time", "length"])
    states = states.merge(led, on=["sequence", "state"], how="left")
    if "attempt" not in moves:
        return states.reindex(columns=[*states.columns, *SHAPES])
    attempt = moves.groupby("sequence")["attempt"].first()
    states = states.assign(attempt=states["sequence"].map(attempt))
    return states.merge(tried[["attempt", "state", *SHAPES]], on=["attempt", "state"], how="left")


def _tried(attempts: pd.DataFrame, lists: Sequence[str]) -> pd.DataFrame:
    """A row per state that an attempt reached, from the attempts' rows, whose cells are lists over states."""
    reached = attempts["states"].to_numpy(int)
    row = np.repeat(np.arange(len(attempts)), reached)
    state = np.arange(len(row)) - np.repeat(np.cumsum(reached) - reached, reached)
    table = attempts[["attempt", "accepted"]].iloc[row].reset_index(drop=True).assign(state=state)
    for name in (*MEASURED, *SHAPES, "settle_time"):
        if name not in lists:
            table[name] = np.nan
            continue
        # A settle time belongs to the manipulation before a state, so the first state has none.
        shift = int(name == "settle_time")
        values = attempts[name].tolist()
        table[name] = [_at(values[r], s - shift) for r, s in zip(row.tolist(), state.tolist(), strict=True)]
    # A state that isn't finite has no silhouette.
    table.loc[~(table["area"] > 0), list(SHAPES)] = np.nan
    return table


def _sides(materials: pd.Series) -> tuple[float, float]:
    sides = [float(np.ptp(np.reshape(material, (-1, 2)), axis=0).max()) for material in materials]
    return min(sides), max(sides)


def _at(values: Any, index: int) -> float:
    value = values[index] if values is not None and 0 <= index < len(values) else None
    return np.nan if value is None else float(value)


def _columns(path: Path) -> list[tuple[str, str]]:
    return [(field.name, str(field.type).replace("element: ", "")) for field in pq.read_schema(path)]

"""Recorded sequences one by one, from raw artifacts or from a store of meshes, in metres: what exports are made of."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.dataset import store
from clothkit.dataset.export import chosen_sequences, is_raw, raw_surfaces
from clothkit.dataset.raw import read_cloths, read_manipulations, read_states
from clothkit.dataset.store import LABELS, SPLITS
from clothkit.runtime.errors import InputError

_INSTEAD = "as in the states before; export data/meshes.zarr, whose states are all alike"


class Recorded(NamedTuple):
    """One sequence: its states and the manipulations between them."""

    sequence: int
    """Its number in the source."""
    split: str
    """One of SPLITS; raw artifacts have none, and count as training data."""
    vertices: Float[np.ndarray, "state vertices 3"]
    """Metres, world frame, z up."""
    manipulation: Float[np.ndarray, "step 6"]
    """u1 v1 u2 v2 (geodesic) dx dy (normalised)."""
    cloth: Float[np.ndarray, "3"]
    """Sides along u and v and thickness, in metres; the thickness is NaN where a simulator did not tell it."""
    triangles: Int[np.ndarray, "triangles 3"]


@dataclass(frozen=True)
class Sequences:
    """The sequences of a source, in the order in which they are exported: by split, then by number."""

    split: list[str]
    """The split of each."""
    each: Iterator[Recorded]

    def __len__(self) -> int:
        return len(self.split)


def read_recorded(source: Path, sequences: Sequence[int] | None, *, cloth_side: float) -> Sequences:
    """Some or all sequences of a folder of raw artifacts, or of a store of meshes.

    Meshes of a store are put back where they lay, `cloth_side` [m] wide. Raises InputError if the source or a sequence
    isn't there, and if states have different numbers of vertices, which arrays of one shape can't hold, or different
    triangles, of which a dataset has one list.
    """
    return _raw(source, sequences) if is_raw(source) else _stored(source, sequences, cloth_side)


def _stored(path: Path, sequences: Sequence[int] | None, cloth_side: float) -> Sequences:
    split, _ = store.load_splits(path)
    chosen = np.array(chosen_sequences(path, sequences, list(range(len(split)))))
    of_splits = [chosen[split[chosen] == code] for code in range(len(SPLITS))]
    scale, triangles = np.float32(cloth_side / CLOTH_LENGTH), SQUARE.triangles()

    def of_split(name: str, own: np.ndarray) -> Iterator[Recorded]:
        numbers = iter(own.tolist())
        for part in store.load_parts(path, own):
            for row, length in enumerate(part.length.tolist()):
                centre = np.pad(part.centre[row, : length + 1], ((0, 0), (0, 1)))[:, None]
                vertices = (part.vertices[row, : length + 1].reshape(length + 1, -1, 3) + centre) * scale
                moves = part.manipulation[row, :length]
                yield Recorded(next(numbers), name, vertices, moves, part.cloth[row] * scale, triangles)

    each = chain.from_iterable(of_split(*pair) for pair in zip(SPLITS, of_splits, strict=True))
    return Sequences([name for name, own in zip(SPLITS, of_splits, strict=True) for _ in own], each)


def _raw(folder: Path, sequences: Sequence[int] | None) -> Sequences:
    states = read_states(folder / "states", ("sequence", "state"))
    chosen = chosen_sequences(folder, sequences, states["sequence"].unique().tolist())
    moves = read_manipulations(folder, states).groupby("sequence")
    cloths = read_cloths(folder, chosen)
    _, surfaces = raw_surfaces(folder, chosen)

    def each() -> Iterator[Recorded]:
        first = None
        for sequence, group in groupby(surfaces, key=lambda surface: surface.sequence):
            found = list(group)
            for surface in found:
                first = first or surface
                where = f"{folder}: sequence {sequence}, state {surface.state}"
                if len(surface.vertices) != len(first.vertices):
                    raise InputError(
                        f"{where} has {len(surface.vertices)} vertices, expected {len(first.vertices)} {_INSTEAD}"
                    )
                if not np.array_equal(surface.triangles, first.triangles):
                    raise InputError(f"{where} has another triangulation, expected the same {_INSTEAD}")
            cloth = cloths.loc[sequence, ["side_u", "side_v", "thickness"]].to_numpy(np.float32)
            moved = moves.get_group(sequence)[list(LABELS["component"])].to_numpy(np.float32)
            vertices = np.stack([surface.vertices for surface in found])
            yield Recorded(sequence, SPLITS[0], vertices, moved, cloth, found[0].triangles)

    return Sequences([SPLITS[0]] * len(chosen), each())

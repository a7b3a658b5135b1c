"""Recorded sequences one by one, from raw artifacts or from a store of meshes, in metres: what exports are made of."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
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
    isn't there, and if states have different numbers of vertices, which arrays of one shape can't hold.
    """
    return _raw(source, sequences) if is_raw(source) else _stored(source, sequences, cloth_side)


def _stored(path: Path, sequences: Sequence[int] | None, cloth_side: float) -> Sequences:
    dataset = store.load(path)
    chosen = chosen_sequences(path, sequences, list(range(len(dataset))))
    chosen.sort(key=lambda sequence: dataset.split[sequence])
    scale = np.float32(cloth_side / CLOTH_LENGTH)

    def each() -> Iterator[Recorded]:
        for sequence in chosen:
            count = int(dataset.length[sequence])
            centre = np.pad(dataset.centre[sequence, : count + 1], ((0, 0), (0, 1)))[:, None]
            vertices = dataset.vertices[sequence, : count + 1].reshape(count + 1, -1, 3) + centre
            yield Recorded(
                sequence,
                SPLITS[dataset.split[sequence]],
                vertices * scale,
                dataset.manipulation[sequence, :count],
                dataset.cloth[sequence] * scale,
                SQUARE.triangles(),
            )

    return Sequences([SPLITS[dataset.split[sequence]] for sequence in chosen], each())


def _raw(folder: Path, sequences: Sequence[int] | None) -> Sequences:
    states = read_states(folder / "states", ("sequence", "state"))
    chosen = chosen_sequences(folder, sequences, states["sequence"].unique().tolist())
    moves = read_manipulations(folder, states).groupby("sequence")
    cloths = read_cloths(folder, chosen)
    _, surfaces = raw_surfaces(folder, chosen)

    def each() -> Iterator[Recorded]:
        count = None
        for sequence, group in groupby(surfaces, key=lambda surface: surface.sequence):
            found = list(group)
            for surface in found:
                count = count or len(surface.vertices)
                if len(surface.vertices) != count:
                    raise InputError(
                        f"{folder}: sequence {sequence}, state {surface.state} has {len(surface.vertices)} vertices, "
                        f"expected {count} as in the states before; export data/meshes.zarr, whose states are all alike"
                    )
            cloth = cloths.loc[sequence, ["side_u", "side_v", "thickness"]].to_numpy(np.float32)
            moved = moves.get_group(sequence)[list(LABELS["component"])].to_numpy(np.float32)
            vertices = np.stack([surface.vertices for surface in found])
            yield Recorded(sequence, SPLITS[0], vertices, moved, cloth, found[0].triangles)

    return Sequences([SPLITS[0]] * len(chosen), each())

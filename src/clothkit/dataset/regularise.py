"""Converts raw states of any triangulation to normalised, centred meshes of a grid, and assigns splits (4.2.1, 4.4)."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd
from annotated_types import Ge, Gt
from jaxtyping import Float, Int
from tqdm import tqdm

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH, PAPERS_CLOTH, SQUARE, Shape, Topology
from clothkit.dataset.raw import (
    STATE_COLUMNS,
    StateFiles,
    Topologies,
    Triangulation,
    read_cloths,
    read_manipulations,
)
from clothkit.dataset.store import SHARD, SPLITS, STATES, STEPS, Dataset, Parts, join
from clothkit.runtime.config import config
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.settings import DRAWN, STARTS

MARGIN = 1e-3
"""A point counts as covered if no barycentric weight is below -MARGIN, since coordinates may be rounded to 6 digits."""

NEARLY_SQUARE = 0.01
"""Largest difference between the sides of a square, as a fraction of the longer one."""

KEPT = 64
"""Largest number of cached interpolations; ARCSim writes a topology for every state."""


@config
class RegulariseConfig:
    """Numbers of sequences in the splits and in evaluations."""

    train: Annotated[int, Gt(0)]
    validation: Annotated[int, Gt(0)]
    test: Annotated[int, Gt(0)]
    evaluated: Annotated[int, Gt(0)] = 100
    """Number of test sequences, and also of training sequences, that evaluations use."""
    seed: Annotated[int, Ge(0)] = 0


class Interpolation(NamedTuple):
    """Barycentric interpolation: for each grid vertex, three vertices of the triangulation and their weights."""

    vertices: Int[np.ndarray, "grid 3"]
    weights: Float[np.ndarray, "grid 3"]
    shape: Shape

    def __call__(self, positions: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, "u v 3"]:
        """The positions of the grid's vertices, interpolated from those of the triangulation's."""
        return np.einsum("gk,gkc->gc", self.weights, positions[self.vertices]).reshape(*self.shape, 3)


def interpolation(
    material: Float[np.ndarray, "vertices 2"],
    triangles: Int[np.ndarray, "triangles 3"],
    topology: Topology = SQUARE,
    *,
    name: str = "topology",
) -> Interpolation:
    """The barycentric interpolation in material space [m]; it is exact for maps that are linear on each triangle.

    Raises InputError, which names the triangulation by `name`, if the triangles don't cover the cloth's rectangle.
    """
    low, high = material.min(0), material.max(0)
    targets = (topology.geodesic().reshape(-1, 2).astype(float) + 1) / 2 * (high - low) + low
    a, b, c = (material[triangles[:, k]].astype(float) for k in range(3))
    edge_b, edge_c = b - a, c - a
    area = edge_b[:, 0] * edge_c[:, 1] - edge_b[:, 1] * edge_c[:, 0]
    target, triangle = _candidate_pairs(targets.reshape(*topology.shape, 2), np.stack([a, b, c]))
    target, triangle = (index[area[triangle] != 0] for index in (target, triangle))
    edge_b, edge_c, area, offset = edge_b[triangle], edge_c[triangle], area[triangle], targets[target] - a[triangle]
    weight_b = (offset[:, 0] * edge_c[:, 1] - offset[:, 1] * edge_c[:, 0]) / area
    weight_c = (edge_b[:, 0] * offset[:, 1] - edge_b[:, 1] * offset[:, 0]) / area
    weights = np.stack([1 - weight_b - weight_c, weight_b, weight_c], axis=-1)
    # Of several triangles that contain a target, the one with the largest least weight is used, or the first of equals.
    order = np.lexsort((triangle, -weights.min(-1), target))
    covered, first = np.unique(target[order], return_index=True)
    chosen = weights[order[first]]
    if len(covered) < len(targets) or chosen.min() < -MARGIN:
        raise InputError(f"{name}: its triangles leave part of the material square uncovered")
    chosen = np.clip(np.where(np.abs(chosen) < 1e-6, 0, chosen), 0, 1)
    return Interpolation(triangles[triangle[order[first]]], chosen / chosen.sum(-1, keepdims=True), topology.shape)


def _candidate_pairs(
    targets: Float[np.ndarray, "u v 2"], corners: Float[np.ndarray, "3 triangles 2"]
) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]:
    """Pairs of a target (index u * side + v) and a triangle whose bounding box contains it.

    Only these few candidate pairs need an exact test.
    """
    low, high = corners.min(0), corners.max(0)
    # A point with two weights of -MARGIN lies outside the box by up to 2 MARGIN times its size.
    slack = 2.1 * MARGIN * (high - low)
    firsts, counts = [], []
    for axis, line in enumerate((targets[:, 0, 0], targets[0, :, 1])):
        firsts.append(np.searchsorted(line, (low - slack)[:, axis], side="left"))
        counts.append(np.searchsorted(line, (high + slack)[:, axis], side="right") - firsts[-1])
    pairs = counts[0] * counts[1]
    triangle = np.repeat(np.arange(len(pairs)), pairs)
    place = np.arange(pairs.sum()) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    u, v = np.divmod(place, np.maximum(counts[1], 1)[triangle])
    return (firsts[0][triangle] + u) * targets.shape[1] + firsts[1][triangle] + v, triangle


def regularise(raw: Path, settings: RegulariseConfig, topology: Topology = SQUARE) -> Dataset:
    """As `regularised`, with all sequences in memory."""
    return join(regularised(raw, settings, topology))


def regularised(raw: Path, settings: RegulariseConfig, topology: Topology = SQUARE) -> Parts:
    """Make a dataset of meshes of the given topology from a folder of raw artifacts, one part in memory at a time.

    Raises InputError if there are fewer sequences than the splits need, or if a file does not match its schema; faulty
    states are told when their part is made.
    """
    files = StateFiles(raw / "states")
    manipulations = read_manipulations(raw, files.index)
    wanted = settings.train + settings.validation + settings.test
    sequences = files.index["sequence"].unique()[:wanted].tolist()
    if len(sequences) < wanted:
        raise InputError(
            f"{raw}: holds {len(sequences)} sequences, params ask for {wanted} (train + validation + test); raise "
            "simulate.sequences, add runs if they are ARCSim's, or lower regularise"
        )
    of_all: tuple[np.ndarray, ...] = (
        *_steps(manipulations, {sequence: row for row, sequence in enumerate(sequences)}),
        *assign_splits(settings),
        *_cloths(read_cloths(raw, sequences)),
    )
    mesher = Mesher(Topologies(raw), topology)

    def each() -> Iterator[Dataset]:
        bar = tqdm(total=wanted, desc="regularise", unit="sequence", mininterval=1)
        for first in range(0, wanted, SHARD):
            part = slice(first, first + SHARD)
            meshes = _meshes(raw, files.read(sequences[part]), sequences[part], mesher, bar)
            yield Dataset(*meshes, *(values[part] for values in of_all))
        bar.close()

    return Parts(wanted, each())


def _meshes(
    raw: Path, states: pd.DataFrame, sequences: Sequence[int], mesher: "Mesher", bar: tqdm
) -> tuple[np.ndarray, np.ndarray]:
    """The centred meshes [sequence state u v 3] of sequences, and their centres [sequence state 2]."""
    vertices = np.full((len(sequences), STATES, *mesher.topology.shape, 3), np.nan, np.float32)
    centres = np.full((len(sequences), STATES, 2), np.nan, np.float32)
    row_of = {sequence: row for row, sequence in enumerate(sequences)}
    for sequence, state, number, positions in zip(*(states[name] for name in STATE_COLUMNS), strict=True):
        mesh = mesher(f"{raw}: sequence {sequence}, state {state}", number, positions)
        vertices[row_of[sequence], state], centres[row_of[sequence], state] = centred(mesh)
        bar.update(int(state == 0))
    return vertices, centres


def _cloths(table: pd.DataFrame) -> Cloths:
    """The cloths of sequences. A thickness that a simulator did not tell is taken to be that of PAPERS_CLOTH."""
    metres = table[["side_u", "side_v", "thickness"]].to_numpy(float)
    cloth = metres * (CLOTH_LENGTH / metres[:, :2].max(1, keepdims=True))
    cloth = np.where(np.isnan(cloth), PAPERS_CLOTH, cloth).astype(np.float32)
    start = np.array([STARTS.index(start) if start in STARTS else 0 for start in table["start"]], np.int8)
    return Cloths(cloth, start, table[list(DRAWN)].to_numpy(np.float32))


def assign_splits(settings: RegulariseConfig) -> tuple[np.ndarray, np.ndarray]:
    """A random split for each sequence (index into SPLITS), and whether evaluations use the sequence."""
    counts = [settings.train, settings.validation, settings.test]
    split = np.repeat(np.arange(len(SPLITS), dtype=np.int8), counts)
    split = np.random.default_rng(settings.seed).permutation(split)
    evaluated = np.zeros(len(split), bool)
    for name in ("train", "test"):
        evaluated[np.flatnonzero(split == SPLITS.index(name))[: settings.evaluated]] = True
    return split, evaluated


class Mesher:
    """Converts raw states to normalised meshes [u v 3] at their place on the table; interpolations are cached.

    A call takes a name for error messages, the triangulation's number and the flat list of vertex coordinates [m]. It
    raises InputError if the triangulation is unknown, does not cover the cloth, or has another number of vertices.
    """

    def __init__(self, topologies: Topologies, topology: Topology = SQUARE) -> None:
        self.topologies, self.topology = topologies, topology
        self.cache: dict[int, tuple[Interpolation, float]] = {}

    def __call__(self, where: str, number: int, vertices: np.ndarray) -> Float[np.ndarray, "u v 3"]:
        shared, positions = self.topologies(where, number, vertices)
        if number not in self.cache:
            if len(self.cache) == KEPT:
                self.cache.clear()
            self.cache[number] = self._make(number, shared)
        interpolate, scale = self.cache[number]
        return (interpolate(positions) * scale).astype(np.float32)

    def _make(self, number: int, shared: Triangulation) -> tuple[Interpolation, float]:
        name = f"{self.topologies.path}: topology {number}"
        sides = np.ptp(shared.material, axis=0)
        # Other programs' squares need not be exact.
        length = float(sides.mean() if np.ptp(sides) < NEARLY_SQUARE * sides.max() else sides.max())
        return interpolation(shared.material, shared.triangles, self.topology, name=name), CLOTH_LENGTH / length


def _steps(table: pd.DataFrame, row_of: dict[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    count = len(row_of)
    manipulation = np.full((count, STEPS, 6), np.nan, np.float32)
    hands = np.zeros((count, STEPS), np.int8)
    table = table[table["sequence"].isin(row_of)]
    rows = table["sequence"].map(row_of).to_numpy()
    steps = table["step"].to_numpy()
    manipulation[rows, steps] = table[["u1", "v1", "u2", "v2", "dx", "dy"]].to_numpy(np.float32)
    hands[rows, steps] = table["hands"].to_numpy(np.int8)
    return manipulation, hands, (hands > 0).sum(-1).astype(np.int8)

"""Layers are moved apart in the order that they have in the mean, and nothing else is."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE
from clothkit.estimation.layering import APART, HIGHEST_RISE, lift, neighbours, overlapping
from clothkit.simulation.quality import intersections

THICKNESS = 0.007
SIDES = (1.4, 1.4)
REACH = 1.4 / 31


def in_half(turned: float = 0.0) -> np.ndarray:
    """A cloth folded along u = 0 with layers a thickness apart, turned about z."""
    mesh = SQUARE.flat().astype(float)
    x = mesh[..., 0] + 0.3 * REACH
    along = np.abs(x)
    # The fold is a half circle.
    radius = THICKNESS / 2
    bend = np.clip(x / radius, -np.pi / 2, np.pi / 2)
    mesh[..., 0] = np.where(along < radius * np.pi / 2, radius * np.cos(bend), radius * np.pi / 2 - along)
    mesh[..., 2] = THICKNESS + radius * np.sin(bend)
    c, s = np.cos(turned), np.sin(turned)
    mesh[..., :2] = mesh[..., :2] @ np.array([[c, s], [-s, c]])
    return mesh


def roughened(mesh: np.ndarray, size: float, seed: int) -> np.ndarray:
    return (mesh + np.random.default_rng(seed).normal(0, size, mesh.shape) * [0, 0, 1]).astype(np.float32)


@settings(max_examples=5)
@given(st.floats(0, 6.28), st.integers(0, 1000))
def test_layers_that_pierce_each_other_in_stripes_are_moved_apart(turned: float, seed: int) -> None:
    rough = roughened(in_half(turned), 0.6 * THICKNESS, seed)
    apart = lift(rough, thickness=THICKNESS, sides=SIDES)
    before, after = intersections(np.stack([rough, apart]))
    assert before > 100
    assert after <= 0.1 * before
    np.testing.assert_array_equal(apart[..., :2], rough[..., :2])
    # The flap with u > 0 stays the upper one.
    assert (apart[20:, :, 2] > apart[11::-1, :, 2]).mean() > 0.99
    assert np.abs(apart[..., 2] - rough[..., 2]).max() < 6 * THICKNESS


def test_meshes_without_overlap_and_layers_that_are_apart_stay_as_they_are() -> None:
    flat = roughened(SQUARE.flat(), 0.01, 0)
    np.testing.assert_array_equal(lift(flat, thickness=THICKNESS, sides=SIDES), flat)
    clear = in_half() * [1, 1, 3]
    np.testing.assert_allclose(lift(clear, thickness=THICKNESS, sides=SIDES), clear, atol=1e-9)


@settings(max_examples=5)
@given(st.floats(0, 6.28), st.floats(0.15, 0.35))
def test_an_overlap_has_one_order_though_the_layers_are_exchanged_over_a_part_of_it(turned: float, part: float) -> None:
    mesh = in_half(turned)
    # The flap is as far below the other layer as it was above, from v = 1 on inwards.
    exchanged = 32 - round(32 * part)
    mesh[:, exchanged:, 2] = 2 * THICKNESS - mesh[:, exchanged:, 2]
    apart = lift(mesh.astype(np.float32), thickness=THICKNESS, sides=SIDES)
    assert (apart[20:, :, 2] > apart[11::-1, :, 2]).mean() > 0.99


def test_no_vertex_goes_below_the_table() -> None:
    low = roughened(in_half() * [1, 1, 0.1], 0.001, 1)
    low[..., 2] = np.maximum(low[..., 2], THICKNESS / 2)
    assert lift(low, thickness=THICKNESS, sides=SIDES)[..., 2].min() >= THICKNESS / 2 - 1e-6


def test_a_thicker_cloth_is_moved_further_apart() -> None:
    rough = roughened(in_half(), 0.003, 2)
    thin, thick = (lift(rough, thickness=t, sides=SIDES)[..., 2] for t in (THICKNESS, 4 * THICKNESS))
    between, more = ((z[20:] - z[11::-1]).mean() for z in (thin, thick))
    assert more > between + 0.5 * THICKNESS


def test_what_lies_above_itself_in_a_circle_rises_to_a_limit() -> None:
    rng = np.random.default_rng(3)
    tangle = (rng.normal(0, 0.2, (32, 32, 3)) * [1, 1, 0.1]).astype(np.float32)
    rise = (lift(tangle, thickness=THICKNESS, sides=SIDES) - tangle)[..., 2].max()
    assert rise == pytest.approx(HIGHEST_RISE * THICKNESS, rel=1e-3)


def test_a_heap_stays_as_it_is() -> None:
    heap = np.random.default_rng(4).normal(0, 0.01, (32, 32, 3)).astype(np.float32)
    np.testing.assert_array_equal(lift(heap, thickness=THICKNESS, sides=SIDES), heap)


@pytest.mark.parametrize("seed", range(3))
def test_pairs_and_their_neighbours_are_those_that_loops_find(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = 6, 7
    vertices = rng.uniform(0, 0.3, (rows * columns, 3))
    pairs = overlapping(vertices, columns, 0.1)
    place = [divmod(k, columns) for k in range(rows * columns)]
    near = [
        (i, j)
        for i, j in product(range(rows * columns), repeat=2)
        if max(abs(a - b) for a, b in zip(place[i], place[j], strict=True)) >= APART
        and np.linalg.norm(vertices[i, :2] - vertices[j, :2]) <= 0.1
    ]
    assert [tuple(pair) for pair in pairs.tolist()] == sorted(near)

    def touch(i: int, j: int) -> bool:
        return max(abs(a - b) for a, b in zip(place[i], place[j], strict=True)) <= 1

    expected = [
        [a != b and touch(a[0], b[0]) and touch(a[1], b[1]) for b in map(tuple, pairs.tolist())]
        for a in map(tuple, pairs.tolist())
    ]
    np.testing.assert_array_equal(neighbours(pairs, (rows, columns)).toarray(), np.array(expected, float))

"""Physics of the solver on folds of a 32 x 32 cloth: layers, rest, hands, refinement, symmetry, and worlds apart."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import CLOTH_LENGTH, REVERSE_V, Topology, rectangle
from clothkit.dataset.store import papers_cloths
from clothkit.simulation.executor import execute, layers_below, place_hands
from clothkit.simulation.kernels.state import PATH
from clothkit.simulation.quality import measure, reason
from clothkit.simulation.settings import Settling, SimulateConfig, SimulationConfig
from clothkit.simulation.solver import LAUNCH_SECONDS, flat_state
from clothkit.simulation.world import Motion, Outcome, Worlds, arcs

SIDE = 32
SETTINGS = SimulationConfig(side=SIDE)
THICKNESS = SETTINGS.material.thickness
WATCHED = 10.0  # s
MOVE = 0.37  # m, of a fold: the edge comes to lie a little inside the one below
NOTHING = Motion(np.full((1, 2, 1), -1), np.zeros((1, 2, int(PATH), 3)), np.array([1e-3]))


def joined(*motions: Motion) -> Motion:
    """Motions of several worlds as one."""
    return Motion(*(np.concatenate(arrays) for arrays in zip(*motions, strict=True)))


def of_columns(state: np.ndarray, columns: list[list[int]], releases: np.ndarray, settings: SimulationConfig) -> Motion:
    """Two hands that take these vertices along arcs to the releases xy [m]."""
    held = np.full((1, 2, max(map(len, columns))), -1)
    for hand, column in enumerate(columns):
        held[0, hand, : len(column)] = column
    return arcs(state[None], held, np.asarray(releases, float)[None], settings)


def half_fold(state: np.ndarray, settings: SimulationConfig, along: np.ndarray | None = None) -> Motion:
    """Two hands that bring the edge u = -1 of a flat cloth over the other, along x unless said otherwise."""
    along = np.array([MOVE, 0.0]) if along is None else along
    releases = state[0, [0, -1], :2] + along
    return of_columns(state, [[0], [settings.side - 1]], releases, settings)


def run(state: np.ndarray, motion: Motion, settings: SimulationConfig = SETTINGS) -> Outcome:
    return Worlds(1, settings).execute(state[None], motion)


def area(state: np.ndarray) -> float:
    """Of the silhouette, as a share of the flat cloth's."""
    mesh = state / np.float32(SETTINGS.cloth_side / CLOTH_LENGTH)
    middle = (mesh.max((0, 1)) + mesh.min((0, 1))) / 2
    covered = silhouette((mesh - middle).astype(np.float32), resolution=256, extent=1.1)
    return float(covered.sum()) * (2.2 / 256) ** 2 / CLOTH_LENGTH**2


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Mean over the vertices [m]."""
    return float(np.linalg.norm(a - b, axis=-1).mean())


def is_clean(state: np.ndarray, settings: SimulationConfig, topology: Topology | None = None) -> None:
    """Nothing is pierced, squeezed or stretched, and nothing is below the table."""
    quality = measure(state[None], settings, topology)
    assert quality.finite[0]
    assert quality.intersections[0] == 0
    assert quality.gap[0] >= 0.5 * settings.material.thickness
    assert quality.strain_p99[0] <= 0.03
    assert quality.strain_worst[0] <= 0.1
    assert quality.lowest[0] >= settings.material.thickness / 2 - 1e-6


@pytest.fixture(scope="module")
def folded() -> Outcome:
    flat = flat_state(SETTINGS)
    return run(flat, half_fold(flat, SETTINGS))


@pytest.fixture(scope="module")
def watched(folded: Outcome) -> tuple[Outcome, np.ndarray]:
    """The folded cloth after ten seconds that count as rest only if it rests in all of them, and what they moved."""
    settings = replace(SETTINGS, settling=Settling(rest_time=WATCHED, longest=WATCHED + 1))
    later = run(folded.states[0], NOTHING, settings)
    return later, later.states[0] - folded.states[0]


def test_flat_cloth_stays_where_it_is() -> None:
    flat = flat_state(SETTINGS)
    outcome = run(flat, NOTHING)
    assert outcome.rested.all()
    np.testing.assert_allclose(outcome.states[0], flat, atol=1e-5)


def test_half_fold_lies_in_two_layers(folded: Outcome) -> None:
    state = folded.states[0]
    assert folded.rested[0]
    assert folded.residual_speed[0] <= SETTINGS.settling.rest_speed
    assert area(state) == pytest.approx(0.5, abs=0.06)
    # Row k lies over row 31 - k; the ridge is left out.
    upper, lower = state[1:11, :, 2], state[:-12:-1, :, 2][1:]
    assert (upper - lower).mean() == pytest.approx(THICKNESS, rel=0.1)
    np.testing.assert_allclose(lower, THICKNESS / 2, atol=1e-4)


def test_fold_line_is_straight_and_low(folded: Outcome) -> None:
    """Not a row of upright grid edges, which lean to either side and are five times as high as two layers."""
    state = folded.states[0]
    outermost = state[state[..., 0].argmin(0), np.arange(state.shape[1])]
    assert outermost[:, 0].std() < 1e-3
    assert outermost[:, 2].std() < 1e-3
    assert state[..., 2].max() < 3 * THICKNESS


def test_half_fold_is_clean(folded: Outcome) -> None:
    is_clean(folded.states[0], SETTINGS)
    quality = measure(folded.states, SETTINGS)
    assert reason(quality, folded, SimulateConfig(sequences=1, simulation=SETTINGS), 0) == ""


def test_half_fold_stays_folded(watched: tuple[Outcome, np.ndarray]) -> None:
    later, moved = watched
    assert later.rested[0]
    is_clean(later.states[0], SETTINGS)
    assert np.linalg.norm(moved, axis=-1).max() < 2e-3


def test_released_cloth_does_not_creep(watched: tuple[Outcome, np.ndarray]) -> None:
    """Neither as a whole nor layer by layer: dry friction holds what lies still."""
    _, moved = watched
    assert np.linalg.norm(moved.mean((0, 1))) < 1e-3
    for layer in (moved[:11], moved[-11:]):
        assert np.linalg.norm(layer.mean((0, 1))) < 1e-3


def test_hands_that_take_all_layers_fold_a_quarter(folded: Outcome) -> None:
    """The half fold folded again, along y, by hands near its edge and near its ridge."""
    settings = replace(SETTINGS, grasp="all")
    state = folded.states[0]
    hands = place_hands(state, state[[1, 12], 0, :2].astype(float), np.array([0.0, MOVE]), False, settings)
    assert ((hands.vertices >= 0).sum(1) == 2).all()
    motion = arcs(state[None], hands.vertices[None], hands.releases[None], settings)
    outcome = run(state, motion, settings)
    state = outcome.states[0]
    assert outcome.rested[0]
    is_clean(state, SETTINGS)
    assert area(state) == pytest.approx(0.25, abs=0.06)
    # Heights of the four layers, from the table up, where no ridge is near.
    layers = [state[-10:-4, -10:-4], state[4:10, -10:-4], state[4:10, 4:10], state[-10:-4, 4:10]]
    heights = [float(layer[..., 2].mean()) for layer in layers]
    np.testing.assert_allclose(heights, (np.arange(4) + 0.5) * THICKNESS, rtol=0.2)


def test_a_hand_that_takes_the_top_leaves_the_rest(folded: Outcome) -> None:
    """A corner of the upper layer folded back; as far from the ridge as that, the lower layer is not pulled along."""
    state = folded.states[0]
    hands = place_hands(state, state[[1, 1], 0, :2].astype(float), np.array([-0.08, 0.1]), True, SETTINGS)
    assert ((hands.vertices >= 0).sum(1) == [1, 0]).all()
    motion = arcs(state[None], hands.vertices[None], hands.releases[None], SETTINGS)
    outcome = run(state, motion)
    assert outcome.rested[0]
    is_clean(outcome.states[0], SETTINGS)
    moved = np.linalg.norm(outcome.states[0] - state, axis=-1)
    assert moved[:3, :3].mean() > 0.08
    assert moved[-11:].max() < 4e-3


def test_a_smaller_time_step_settles_alike(folded: Outcome) -> None:
    settings = replace(SETTINGS, time_step=SETTINGS.time_step / 2)
    flat = flat_state(settings)
    found = run(flat, half_fold(flat, settings), settings)
    assert found.rested[0]
    assert distance(found.states[0], folded.states[0]) < 3e-3


def test_a_finer_grid_settles_alike(folded: Outcome) -> None:
    """The same points of the cloth, on a grid with twice as many edges along a side."""
    settings = replace(SETTINGS, side=2 * SIDE - 1)
    flat = flat_state(settings)
    found = run(flat, half_fold(flat, settings), settings)
    assert found.rested[0]
    is_clean(found.states[0], settings)
    assert distance(found.states[0, ::2, ::2], folded.states[0]) < 5e-3


def test_material_keeps_its_meaning_when_step_and_spacing_are_halved(folded: Outcome) -> None:
    settings = replace(SETTINGS, side=2 * SIDE - 1, time_step=SETTINGS.time_step / 2)
    flat = flat_state(settings)
    found = run(flat, half_fold(flat, settings), settings)
    assert distance(found.states[0, ::2, ::2], folded.states[0]) < 3e-3


def test_hands_follow_the_arc() -> None:
    release = np.array([0.05, 0.02])
    worlds = Worlds(1, SETTINGS)
    flat = flat_state(SETTINGS)
    motion = of_columns(flat, [[0], []], np.array([release, [0.0, 0.0]]), SETTINGS)
    worlds.begin(flat[None], motion)
    start = flat[0, 0].astype(float)
    k = np.hypot(*(release - start[:2]))
    # The circle through (0, 0) and (k, h), centred at height 0, by its perpendicular bisector.
    h = min(SETTINGS.highest_lift * SETTINGS.cloth_side / CLOTH_LENGTH, k / 2)
    centre = k / 2 + h**2 / (2 * k)
    sweep = np.pi - np.arctan2(h, k - centre)
    assert motion.seconds[0] == pytest.approx(max(centre * sweep / SETTINGS.hand_speed, SETTINGS.shortest_move))
    highest = 0.0
    for time, place in followed(worlds, float(motion.seconds[0]), [0]):
        share = time / float(motion.seconds[0])
        angle = np.pi - sweep * (3 * share**2 - 2 * share**3)
        along = centre + centre * np.cos(angle)
        expected = start + np.append((release - start[:2]) / k * along, centre * np.sin(angle))
        np.testing.assert_allclose(place[0], expected, atol=2e-5)
        highest = max(highest, place[0, 2])
    assert highest > 0.8 * centre


def followed(worlds: Worlds, until: float, vertices: list[int]) -> list[tuple[float, np.ndarray]]:
    """Times, and places of some vertices of the first world, launch by launch while hands hold them."""
    found = []
    while True:
        worlds.advance(1)
        time = float(worlds.read("time", 1)[0])
        if time > until:
            return found
        found.append((time, worlds.read("position", 1)[0, vertices]))


def test_held_columns_follow_waypoints(folded: Outcome) -> None:
    """Any path that is given as points at equal times; what a hand holds keeps its places relative to the first."""
    state = folded.states[0]
    top = SIDE + 3  # near the corner of the upper layer
    column = [top, *layers_below(state, top, within=SETTINGS.spacing(SETTINGS.topology)[0] / 2)]
    assert len(column) == 2
    vertices = state.reshape(-1, 3)
    offsets = np.array([[0, 0, 0], [0.01, 0.0, 0.04], [-0.02, 0.03, 0.06], [0.0, 0.05, 0.03]])
    path = np.zeros((1, 2, 4, 3))
    path[0, 0] = vertices[top] + offsets
    worlds = Worlds(1, SETTINGS)
    worlds.begin(state[None], Motion(np.array([[column, [-1, -1]]]), path, np.array([0.9])))
    places = followed(worlds, 0.9, column)
    assert len(places) >= 8
    for time, place in places:
        hand = [np.interp(time, np.linspace(0, 0.9, 4), path[0, 0, :, axis]) for axis in range(3)]
        np.testing.assert_allclose(place[0], hand, atol=5e-4)  # paths are resampled: corners are cut a little
        np.testing.assert_allclose(place - place[0], vertices[column] - vertices[top], atol=1e-6)
    while not worlds.read("done", 1).all():
        worlds.advance(1)
    is_clean(worlds.read("position", 1).reshape(1, SIDE, SIDE, 3)[0], SETTINGS)


def test_outcome_depends_on_nothing_but_its_own_world(folded: Outcome) -> None:
    flat = flat_state(SETTINGS)
    corner = of_columns(flat, [[0], []], np.array([[0.1, 0.12], [0.0, 0.0]]), SETTINGS)
    fold = half_fold(flat, SETTINGS)
    alone = run(flat, corner)
    states = [folded.states[0], flat, flat]
    motions = [NOTHING, corner, fold]
    worlds = Worlds(4, SETTINGS)
    for order in ([0, 1, 2], [2, 1, 2], [1, 0]):
        together = worlds.execute(np.stack([states[k] for k in order]), joined(*(motions[k] for k in order)))
        for place, k in enumerate(order):
            if k > 0:
                expected = alone.states[0] if k == 1 else folded.states[0]
                np.testing.assert_array_equal(together.states[place], expected)


ROUND = {"max_examples": 4, "deadline": None, "derandomize": True}


@settings(**ROUND)
@given(x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3))
def test_outcome_moves_with_the_cloth(folded: Outcome, x: float, y: float) -> None:
    """Not to the last bit, since rounding differs, and what rounding does may grow."""
    shift = np.array([x, y, 0], np.float32)
    state = flat_state(SETTINGS) + shift
    found = run(state, half_fold(state, SETTINGS))
    assert distance(found.states[0], folded.states[0] + shift) < 2e-3


@settings(**ROUND)
@given(quarters=st.integers(1, 3))
def test_outcome_turns_with_the_cloth(folded: Outcome, quarters: int) -> None:
    def turned(points: np.ndarray) -> np.ndarray:
        turn = np.array([[0, 1], [-1, 0]])
        xy = points[..., :2] @ np.linalg.matrix_power(turn, quarters).astype(np.float32)
        return np.concatenate([xy, points[..., 2:]], axis=-1).astype(np.float32)

    state = turned(flat_state(SETTINGS))
    found = run(state, half_fold(state, SETTINGS, turned(np.array([MOVE, 0.0]))))
    assert distance(found.states[0], turned(folded.states[0])) < 2e-3


def test_more_states_than_worlds() -> None:
    flat = flat_state(SETTINGS)
    with pytest.raises(ValueError, match="2 states for 1 worlds"):
        Worlds(1, SETTINGS).execute(np.stack([flat, flat]), joined(NOTHING, NOTHING))


def test_a_world_that_never_rests_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """After its own budget of steps, whatever runs beside; one that comes to rest does not notice."""
    settings = SimulationConfig(side=16)
    flat = flat_state(settings)
    fold = half_fold(flat, settings)
    expected = run(flat, fold, settings)
    worlds = Worlds(2, settings)
    restless = NOTHING._replace(seconds=np.array([1.5]))
    budgets = worlds.budget(np.concatenate([restless.seconds, fold.seconds]))
    assert (budgets * LAUNCH_SECONDS > 2 * (4 + np.array([1.5, fold.seconds[0]]))).all()
    # Short of its hands' motion, and of nobody else's.
    monkeypatch.setattr(worlds, "budget", lambda seconds: np.where(seconds == 1.5, 3, budgets[1]))
    found = worlds.execute(np.stack([flat, flat]), joined(restless, fold))
    assert found.spent.tolist() == [True, False]
    assert found.rested.tolist() == [False, True]
    assert expected.spent.tolist() == [False]
    np.testing.assert_array_equal(found.states[1], expected.states[0])
    assert float(worlds.read("time", 2)[0]) == pytest.approx(3 * LAUNCH_SECONDS, abs=1e-3)


@pytest.mark.parametrize("seconds", [np.nan, np.inf, 1e9])
def test_motions_without_end_are_not_begun(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    settings = SimulationConfig(side=16)
    worlds, flat = Worlds(1, settings), flat_state(settings)
    monkeypatch.setattr(worlds, "advance", lambda count: pytest.fail("a step was run"))
    found = worlds.execute(flat[None], NOTHING._replace(seconds=np.array([seconds])))
    assert found.spent.tolist() == [True]
    np.testing.assert_array_equal(found.states[0], flat)


STRIP = Topology((16, 32), (0.6, CLOTH_LENGTH), (0, REVERSE_V))
"""A strip that is none of the package's cloths: longer along v, with fewer vertices along u and two symmetries."""


def fold_across(topology: Topology, axis: int) -> Outcome:
    """The half fold of a flat cloth along an axis: two hands bring one of its edges short of the other."""
    flat = flat_state(SETTINGS, topology)
    rows, columns = topology.shape
    corners = [0, columns - 1] if axis == 0 else [0, (rows - 1) * columns]
    releases = flat.reshape(-1, 3)[corners, :2]
    releases[:, axis] += np.ptp(flat[..., axis]) - 0.03
    motion = of_columns(flat, [[corner] for corner in corners], releases, SETTINGS)
    return Worlds(1, SETTINGS, topology).execute(flat[None], motion)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("topology", [rectangle(1.8), rectangle(1.8, shape=(16, 16)), STRIP], ids=str)
def test_cloths_that_are_no_squares_fold_and_keep_their_lengths(topology: Topology, axis: int) -> None:
    outcome = fold_across(topology, axis)
    state = np.moveaxis(outcome.states[0], axis, 0)
    assert outcome.rested[0]
    is_clean(outcome.states[0], SETTINGS, topology)
    # One layer over the other, but for the ridge, in which the rows in the middle lie.
    quarter = topology.shape[axis] // 4
    upper, lower = state[1:quarter, :, 2], state[::-1][1:quarter, :, 2]
    np.testing.assert_allclose(lower, THICKNESS / 2, atol=1e-4)
    assert (upper - lower).mean() == pytest.approx(THICKNESS, rel=0.15)


def test_a_grid_with_two_spacings_folds_as_one_with_equal_spacings() -> None:
    """Stretch, shear, bending, mass and viscosity of a cloth do not depend on how it is divided into quads."""
    ratio = 23 / 12
    even, uneven = (fold_across(rectangle(ratio, shape=shape), 0).states[0] for shape in ((24, 13), (24, 25)))
    assert distance(even, uneven[:, ::2]) < 2e-3


def test_u_and_v_are_alike() -> None:
    lengthwise, across = (
        fold_across(rectangle(ratio, shape=(16, 16)), axis) for ratio, axis in ((1.5, 0), (1 / 1.5, 1))
    )
    assert distance(lengthwise.states[0], across.states[0].swapaxes(0, 1)[..., [1, 0, 2]]) < 5e-4


def test_a_rectangle_is_executed_by_its_grasp_points_on_workers_as_here() -> None:
    topology = rectangle(1.6, shape=(16, 16))
    meshes = np.stack([topology.flat()] * 4)
    grasps = np.repeat(np.array([[[-0.7, -0.7 / 1.6], [-0.7, 0.7 / 1.6]]]), 4, axis=0)
    moves = np.array([[1.2, 0.0], [0.6, 0.0], [0.8, 0.1], [1.0, -0.1]])
    single = np.zeros(4, bool)
    cloths = papers_cloths(4)._replace(cloth=np.tile(np.array([1.4, 1.4 / 1.6, 0.007], np.float32), (4, 1)))
    settings = replace(SETTINGS, side=16)
    found = [execute(meshes, grasps, moves, single, cloths, settings=settings, workers=workers) for workers in (1, 2)]
    np.testing.assert_array_equal(*found)
    # The edge is let go where eq. (1) says; when the loop behind it falls flat, it slides on a little.
    np.testing.assert_allclose(found[0][0, 0, [0, -1], 0], 0.6, atol=0.1)
    np.testing.assert_allclose(found[0][0, -1], topology.flat()[-1], atol=0.02)


def test_states_of_another_grid_are_refused() -> None:
    meshes, still = rectangle(1.6, shape=(16, 16)).flat()[None], np.zeros((1, 2))
    with pytest.raises(ValueError, match=r"states of \(16, 16\) vertices for worlds of \(32, 32\)"):
        execute(meshes, np.zeros((1, 2, 2)), still, np.zeros(1, bool), papers_cloths(1), settings=SETTINGS, workers=1)

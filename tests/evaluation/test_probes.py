"""Probes in the toy world: what is drawn, what is executed, and what is told of it."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.dataset.store import SPLITS
from clothkit.evaluation import probes
from clothkit.evaluation.probes import KINDS
from clothkit.evaluation.settings import ProbeConfig
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.vector import is_null
from clothkit.models import support_model
from clothkit.models.settings import SupportModelConfig
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.support import supported_plans
from clothkit.planning.types import Candidates, Problem
from clothkit.planning.uncertainty import Spread
from tests import toy_dataset
from tests.planning import toy

SETTINGS = ProbeConfig(sequences=6, displaced=1, grasped=2, random=1)


@pytest.fixture(scope="module")
def dataset() -> toy_dataset.Dataset:
    """Eight validation sequences."""
    found = toy_dataset.dataset(8)
    found.split[:] = SPLITS.index("validation")
    return found


@pytest.fixture(scope="module")
def done(dataset: toy_dataset.Dataset, tmp_path_factory: pytest.TempPathFactory) -> probes.Probes:
    """Probes of the first six."""
    work = tmp_path_factory.mktemp("probes")
    return probes.execute_probes(dataset, SETTINGS, toy.CANDIDATES, toy.execute, work=work)


def test_every_state_has_its_probes(done: probes.Probes) -> None:
    counts = {kind: int((done.kind == i).sum()) for i, kind in enumerate(KINDS)}
    assert counts == {"recorded": 18, "displaced": 18, "grasped": 36, "random": 6}
    assert set(done.sequence) == set(range(6))
    planned = np.isfinite(done.manipulation).all(2)
    assert not np.asarray(is_null(done.manipulation[planned])).any()
    assert (planned.sum(1)[done.kind == KINDS.index("random")] == 3).all()
    np.testing.assert_array_equal(planned, np.isfinite(done.outcome).all((2, 3, 4)))


def test_displaced_hands_are_at_candidates(done: probes.Probes) -> None:
    for row in np.flatnonzero(done.kind == KINDS.index("displaced")):
        candidates = MESH.candidates(done.state[row], toy.CANDIDATES)
        for hand in done.manipulation[row, 0, :4].reshape(2, 2):
            assert np.abs(candidates - hand).max(1).min() < 1e-6


def test_outcomes_are_those_of_the_world(done: probes.Probes) -> None:
    for row in np.flatnonzero(done.kind == KINDS.index("random"))[:2]:
        state = done.state[row]
        for step in range(3):
            own = done.manipulation[row, step]
            hands = np.asarray(to_cartesian(np.stack([state, state]), own[:4].reshape(2, 2)))[None, :, :2]
            state = toy.execute(state[None], hands, own[None, 4:], np.zeros(1, bool))[0]
            # Centred by the silhouette, so up to a shift in x and y.
            offset = done.outcome[row, step] - state
            np.testing.assert_allclose(offset - offset.mean((0, 1)), 0, atol=1e-5)
            state = done.outcome[row, step]


def test_a_killed_run_goes_on(dataset: toy_dataset.Dataset, done: probes.Probes, tmp_path: Path) -> None:
    calls = []

    def counted(*arguments: object) -> np.ndarray:
        calls.append(len(arguments[0]))  # type: ignore[arg-type]
        if len(calls) == 4:
            raise KeyboardInterrupt
        return toy.execute(*arguments)  # type: ignore[arg-type]

    with pytest.raises(KeyboardInterrupt):
        probes.execute_probes(dataset, SETTINGS, toy.CANDIDATES, counted, work=tmp_path)
    before = len(calls)
    again = probes.execute_probes(dataset, SETTINGS, toy.CANDIDATES, counted, work=tmp_path)
    assert len(calls) == before + 3
    for found, expected in zip(again, done, strict=True):
        np.testing.assert_array_equal(found, expected)


def apart(state: np.ndarray, plans: np.ndarray) -> np.ndarray:
    """Logarithm of the nets' difference after each manipulation of each plan [plan step]."""
    after = []
    for net in toy.NETS:
        latent, trace, own = jnp.tile(state.reshape(1, -1), (len(plans), 1)), jnp.zeros((len(plans), 3072)), []
        for step in range(plans.shape[1]):
            latent, trace, _ = toy.step(net, latent, trace, jnp.asarray(plans[:, step]))
            own.append(toy.decode(net, latent))
        after.append(own)
    return np.log(np.stack([np.asarray(MESH.difference(a, b)) for a, b in zip(*after, strict=True)], axis=1) + 1e-6)


def z_by_hand(dataset: toy_dataset.Dataset, done: probes.Probes, row: int) -> np.ndarray:
    """Of each manipulation of a probe: 64 plans are drawn on the support of its start and rolled out step by step."""
    state, sequence, start = done.state[row], int(done.sequence[row]), int(done.start[row])
    points = MESH.candidates(state, toy.CANDIDATES)
    candidates = Candidates(jnp.asarray(np.resize(points, (toy.CANDIDATES.most, 2))), jnp.int32(len(points)))
    problem = Problem(
        jnp.asarray(state), state, candidates, (jnp.zeros((8, 3072)),) * 2, jnp.int32(0), jnp.asarray(False),
        np.zeros((3, 6)), dataset.cloth[sequence], jnp.asarray(MESH.covered(state)),
    )  # fmt: skip
    key = jax.random.key(0)
    for part in (sequence, start, 64):
        key = jax.random.fold_in(key, part)
    plans = supported_plans(toy.MODEL, MESH, toy.NETS[0], problem, count=64, length=3, key=key)
    usual = apart(state, np.asarray(plans))
    median = np.median(usual, axis=0)
    spread = np.maximum(1.4826 * np.median(np.abs(usual - median), axis=0), 0.1)
    steps = int(np.isfinite(done.manipulation[row]).all(1).sum())
    own = apart(state, np.nan_to_num(done.manipulation[row])[None])[0]
    return ((own - median) / spread)[:steps]


def test_rows_tell_errors_and_measures(dataset: toy_dataset.Dataset, done: probes.Probes) -> None:
    shown = np.zeros((4, 3078), np.float32)
    support = support_model.initial(SupportModelConfig(hidden=(4,)), shown, jax.random.key(0))
    found = probes.predicted(toy.Nets(), support, done, dataset.cloth[done.sequence], toy.CANDIDATES)
    rows = probes.table(done, found, Spread(np.full(3, 0.1), np.full(3, 0.2)))
    of_probe = np.repeat(np.arange(len(done.kind)), np.isfinite(done.manipulation).all(2).sum(1))
    # One of a single manipulation, and one of three.
    for row in (np.flatnonzero(done.kind == KINDS.index(kind))[-1] for kind in ("displaced", "random")):
        z = rows.loc[of_probe == row, "conditional"]
        np.testing.assert_allclose(z, z_by_hand(dataset, done, row), rtol=0.01, atol=0.01)
    assert len(rows) == np.isfinite(done.manipulation).all(2).sum()
    assert {"error_0", "error_1", "expected", "surprise"} <= set(rows.columns)
    np.testing.assert_allclose(rows["deviations"], (rows["difference"] - 0.1) / 0.2, rtol=1e-5)
    # The second net drags vertices 3 % farther; the mean of both is wrong by less than the worse of them.
    assert (rows["error"] <= rows[["error_0", "error_1"]].max(axis=1) + 1e-6).all()
    sums = rows[rows["kind"] == "random"].groupby(["sequence", "start"])["surprise"]
    assert sums.apply(lambda own: own.is_monotonic_increasing).all()
    assert np.isfinite(rows["expected"]).all()
    map_of_all = probes.fitted_to(rows)
    assert map_of_all.offset.shape == (3,)


def test_steps_that_no_validation_sequence_has_are_in_no_deviations(
    dataset: toy_dataset.Dataset, done: probes.Probes
) -> None:
    """Random plans have three manipulations, whatever was recorded."""
    support = support_model.initial(SupportModelConfig(hidden=(4,)), np.zeros((4, 3078), np.float32), jax.random.key(0))
    found = probes.predicted(toy.Nets(), support, done, dataset.cloth[done.sequence], toy.CANDIDATES)
    rows = probes.table(done, found, Spread(np.full(2, 0.1), np.full(2, 0.2)))
    np.testing.assert_array_equal(rows["deviations"].isna(), rows["step"] == 3)
    assert np.isfinite(rows["difference"]).all()

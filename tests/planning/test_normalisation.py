"""Eq. (14) and the moments of eq. (15) on the toy world, and what a file of them must hold."""

import dataclasses
import json
from pathlib import Path
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from clothkit.planning import normalisation
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import load, normalise, save
from clothkit.planning.settings import NormaliseConfig
from clothkit.runtime.errors import InputError
from tests.episodes.test_sessions import dataset
from tests.planning import toy


def whitened(mean: np.ndarray, std: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray | None]:
    spread = np.maximum(mean.std((0, 1)), 0.005)
    return (mean - mean.mean((0, 1))) / spread, None if std is None else std / spread


def outcomes(mesh: np.ndarray, plan: np.ndarray) -> list[np.ndarray]:
    """What each toy net predicts: memory makes vertices follow farther at every manipulation after the first."""
    found = []
    for net in toy.NETS:
        state = jnp.asarray(mesh)
        for i, manipulation in enumerate(plan):
            state = toy.dragged(state, jnp.asarray(manipulation), net * (1 + 0.02 * i))
        found.append(np.asarray(state))
    return found


def scores(start: np.ndarray, goal: np.ndarray, plan: np.ndarray) -> tuple[list[float], float]:
    """The NLL of each net's outcome, and how far the nets differ."""
    (mean, sigma), (other, other_sigma) = (
        whitened(outcome, np.full_like(outcome, 0.015)) for outcome in outcomes(start, plan)
    )
    aimed = whitened(goal)[0]
    of_nets = [-norm.logpdf(aimed, *of).mean() for of in ((mean, sigma), (other, other_sigma))]
    return of_nets, ((mean - other) ** 2).mean() / 2 + ((sigma - other_sigma) ** 2).mean() / 2


def test_medians_and_moments_by_hand() -> None:
    """low is of the recorded manipulations, high of random ones, from every start; mu and sigma of how nets differ."""
    data, random, drawn = dataset(), np.random.default_rng(0), []

    def draw(shape: tuple[int, ...], **_: object) -> jnp.ndarray:
        drawn.append(random.uniform(-1, 1, (*shape, 6)).astype(np.float32))
        return jnp.asarray(drawn[-1])

    with mock.patch.object(normalisation, "random_manipulations", draw):
        found = normalise(toy.MODEL, MESH, toy.NETS, data, NormaliseConfig(draws=2))
    for length in (1, 2):
        tasks = [(d, i) for d in range(len(data)) for i in range(4 - length)]
        ends = [(data.vertices[d, i], data.vertices[d, i + length]) for d, i in tasks]
        plans = [data.manipulation[d, i : i + length] for d, i in tasks]
        recorded = [scores(*of, plan) for of, plan in zip(ends, plans, strict=True)]
        of_length = [plans for plans in drawn if plans.shape[1] == length]
        assert len(of_length) == 2
        at_random = [scores(*of, plan) for plans in of_length for of, plan in zip(ends, plans, strict=True)]
        last = length - 1
        for net in range(2):
            low, high = (np.median([of_nets[net] for of_nets, _ in of]) for of in (recorded, at_random))
            assert high > low + 1
            assert found.low[net][last] == pytest.approx(low, rel=1e-3)
            assert found.high[net][last] == pytest.approx(high, rel=1e-3)
        apart = [difference for _, difference in recorded]
        assert found.mu[last] == pytest.approx(np.mean(apart), rel=1e-2)
        assert found.sigma[last] == pytest.approx(np.std(apart), rel=1e-2)
    reference = found.reference(2)
    np.testing.assert_array_equal(reference.spans[1], np.float32([found.low[1][:2], found.high[1][:2]]))
    assert reference.spread.mean.tolist() == pytest.approx(found.mu[:2])
    assert reference.spread.std.tolist() == pytest.approx(found.sigma[:2])


def test_reference_values_end_with_the_longest_sequence(tmp_path: Path) -> None:
    data = dataset()
    data.length[:] = [2, 1]
    data.vertices[[0, 1, 1], [3, 2, 3]] = np.nan
    data.manipulation[[0, 1, 1], [2, 1, 2]] = np.nan
    found = normalise(toy.MODEL, MESH, toy.NETS, data, NormaliseConfig(draws=2))
    assert len(found.mu) == len(found.sigma) == len(found.low[0]) == len(found.high[1]) == 2
    save(tmp_path / "mesh.json", found, {})
    assert load(tmp_path / "mesh.json") == found
    assert found.reference(2).spread.mean.shape == (2,)
    with pytest.raises(InputError, match="plans of 3 manipulations, found them for up to 2"):
        found.reference(3)


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "mesh.json"
    save(path, toy.NORMALISATION, {"seed": 0})
    assert load(path) == toy.NORMALISATION
    stored = json.loads(path.read_text())
    path.write_text(json.dumps({**stored, "high": [[-2.0] * 3] * 2}))
    with pytest.raises(InputError, match=r"mesh\.json.*low below high"):
        load(path)
    path.write_text('{"mu": [],' + json.dumps(stored)[1:])
    with pytest.raises(InputError, match=r'mesh\.json.*found key "mu" twice'):
        load(path)
    path.write_text(path.read_text()[:40])
    with pytest.raises(InputError, match=r"mesh\.json.*expected JSON"):
        load(path)
    with pytest.raises(InputError, match="not found"):
        load(tmp_path / "no.json")
    with pytest.raises(InputError, match="the same"):
        dataclasses.replace(toy.NORMALISATION, sigma=(0.0, 1.0, 1.0))


def test_a_single_net_differs_from_none(tmp_path: Path) -> None:
    data = dataset()
    data.length[:] = 1
    alone = normalise(toy.MODEL, MESH, toy.NETS[1:], data, NormaliseConfig(draws=1))
    both = normalise(toy.MODEL, MESH, toy.NETS, data, NormaliseConfig(draws=1))
    assert (alone.mu, alone.sigma) == ((), ())
    np.testing.assert_allclose([alone.low[0], alone.high[0]], [both.low[1], both.high[1]], rtol=1e-5)
    save(tmp_path / "mesh.json", alone, {})
    assert load(tmp_path / "mesh.json") == alone
    reference = alone.reference(1)
    assert len(reference.spans) == 1
    assert reference.spread.mean.shape == reference.spread.std.shape == (0,)
    with pytest.raises(InputError, match="plans of 2 manipulations, found them for up to 1"):
        alone.reference(2)
    with pytest.raises(InputError, match="no mu and no sigma for a single net"):
        dataclasses.replace(alone, mu=(0.1,), sigma=(0.1,))


def test_three_nets_differ_by_the_mean_over_their_pairs() -> None:
    data = dataset()
    data.length[:] = 1
    three = (*toy.NETS, jnp.float32(0.95))
    found = normalise(toy.MODEL, MESH, three, data, NormaliseConfig(draws=1))
    assert len(found.low) == len(found.high) == 3
    apart = []
    for vertices, plan in zip(data.vertices, data.manipulation, strict=True):
        start, move = jnp.asarray(vertices[0]), jnp.asarray(plan[0])
        moved = [np.asarray(toy.dragged(start, move, net)) for net in three]
        ends = [whitened(mesh, np.full_like(mesh, 0.015)) for mesh in moved]
        differences = [
            (((a[0] - b[0]) ** 2).mean() + ((a[1] - b[1]) ** 2).mean()) / 2
            for a, b in ((ends[0], ends[1]), (ends[0], ends[2]), (ends[1], ends[2]))
        ]
        apart.append(np.mean(differences))
    assert found.mu == (pytest.approx(np.mean(apart), rel=1e-2),)
    assert found.sigma == (pytest.approx(max(np.std(apart), 0.01 * np.mean(apart)), rel=1e-2),)


@pytest.mark.parametrize(
    "change",
    [
        {"low": "low"},
        {"low": [["a", "b", "c"]] * 2},
        {"mu": [True, True, True]},
        {"mu": [10**400, 1.0, 1.0]},
        {"sigma": [0.1, 0.1]},
        {"high": [[1.0] * 3]},
        {"low": [], "high": []},
        {"mu": None},
        {"mu": [float("nan")] * 3},
        {"sigma": [[0.1]] * 3},
        {"sigma": [1e-300] * 3},
        {"high": [[1e300] * 3] * 2},
        {"high": [[-1.0 + 1e-12] * 3] * 2},
    ],
)
def test_values_that_are_none_are_told_in_one_sentence(tmp_path: Path, change: dict) -> None:
    path = tmp_path / "mesh.json"
    save(path, toy.NORMALISATION, {})
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InputError, match=r"mesh\.json: ") as told:
        load(path)
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize("content", [b"\xff\xfe", b"[" * 100_000, b"null", b"[]", b"12"])
def test_other_files_are_told_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "mesh.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"mesh\.json: expected JSON"):
        load(path)

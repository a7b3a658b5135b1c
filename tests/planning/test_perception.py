"""How unsure a perception is, against the formulas by hand."""

import dataclasses

import jax
import numpy as np
import pytest

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import PAPERS_CLOTH
from clothkit.estimation.estimate import estimate_probabilistic
from clothkit.estimation.refine import RefineConfig
from clothkit.models.net import Net
from clothkit.models.settings import Start
from clothkit.models.vtm import VtMConfig, hypotheses, initial
from clothkit.planning.agent import begin, doubt, perceive
from clothkit.planning.perception import Estimation, Expected, sigma_of, stds_of
from clothkit.planning.types import Observation
from tests.planning import toy


def sigma(std: np.ndarray) -> float:
    """In lengths of a cloth of 1.4."""
    return float(np.sqrt((std.astype(np.float64) ** 2).sum(-1).mean())) / 1.4


def test_what_was_predicted_makes_estimates_surer() -> None:
    config = VtMConfig(hidden=4)
    net = Net(config, initial(config, key=jax.random.key(0)))
    seen = np.zeros((1, 32, 32, 16), bool)
    seen[:, 8:24, 8:24, 0] = True
    observation, cloth = Observation(voxels=seen), PAPERS_CLOTH[None]
    perception = Estimation(net, RefineConfig(prior=2.0), batch=1)
    state = np.asarray(estimate_probabilistic(net, seen, cloth=cloth).mean)
    alone = sigma_of(state, stds_of(perception, observation, state, None, cloth))
    assert alone == pytest.approx(sigma(np.asarray(estimate_probabilistic(net, seen, cloth=cloth).std)), rel=1e-4)
    guess = centred(toy.bent())[0][None].astype(np.float32)
    own = np.asarray(estimate_probabilistic(net, seen, guess, cloth=cloth).std)
    # With `prior`, predictions count with twice their deviations.
    for std in (0.005, 0.05):
        expected = Expected(toy.bent()[None], np.full_like(guess, std))
        both = (own**-2.0 + np.full_like(own, 2 * std) ** -2.0) ** -0.5
        assert sigma_of(state, stds_of(perception, observation, state, expected, cloth)) == pytest.approx(
            sigma(both), rel=1e-3
        )
        assert sigma(both) < sigma(own)
    nothing = Expected(toy.bent()[None], np.full_like(guess, np.inf))
    assert sigma_of(state, stds_of(perception, observation, state, nothing, cloth)) == pytest.approx(
        sigma(own), rel=1e-4
    )


def test_doubt_is_that_of_the_hypothesis_that_the_state_was_refined_from() -> None:
    config = VtMConfig(hidden=4, hypotheses=2)
    net = Net(config, initial(config, Start(sigma=-3.0), key=jax.random.key(3)))
    seen = np.zeros((1, 32, 32, 16), bool)
    seen[:, 8:24, 6:20, 0] = True
    observation, cloth = Observation(voxels=seen), PAPERS_CLOTH[None]
    found = hypotheses(net, seen, cloth)
    perception = Estimation(net, RefineConfig(), batch=1)
    stds = np.asarray(found.mesh.std[0])
    assert not np.allclose(stds[0], stds[1], rtol=1e-3)
    for number in range(2):
        # The less probable one, too: refinement may explain the observation better from there.
        state = np.asarray(found.mesh.mean[:, number])
        assert sigma_of(state, stds_of(perception, observation, state, None, cloth)) == pytest.approx(
            sigma(stds[number]), rel=1e-4
        )
        told = perception.probabilistic(observation, state, None, cloth)
        assert np.asarray(told.std[0]) == pytest.approx(stds[number], rel=1e-4)


def test_each_cloth_of_a_batch_has_its_own_doubt() -> None:
    """Of a first decision, a cloth that lies as it lay, and a predicted one, only the last was predicted."""
    config = VtMConfig(hidden=4)
    net = Net(config, initial(config, key=jax.random.key(0)))
    planner = dataclasses.replace(toy.planner("main"), perception=Estimation(net, RefineConfig(prior=2.0), batch=1))
    seen = np.zeros((3, 32, 32, 16), bool)
    seen[:, 8:24, 8:24, 0] = True
    observation = Observation(voxels=seen)
    memory = begin(planner, np.stack([toy.bent()] * 3), np.array([1, 1, 1]))
    memory = memory._replace(
        planned=np.array([False, True, True]),
        still=np.array([False, True, False]),
        state=np.stack([toy.bent()] * 3),
        expected=np.stack([toy.bent()] * 3),
        unsure=np.full_like(memory.unsure, 0.01),
    )
    state, _ = perceive(planner, observation, memory)
    np.testing.assert_array_equal(state[1], toy.bent())
    stds = doubt(planner, observation, state, memory)
    assert stds is not None
    for row, expected in enumerate((None, None, Expected(memory.expected[2:], memory.unsure[2:]))):
        one = (Observation(voxels=seen[row : row + 1]), state[row : row + 1], expected, memory.cloth[row : row + 1])
        np.testing.assert_allclose(stds[row], planner.perception.probabilistic(*one).std[0], rtol=1e-5)
        assert sigma_of(state, stds)[row] == pytest.approx(sigma(stds[row]), rel=1e-4)
    assert sigma(stds[2]) < sigma(stds[0])
    known = toy.planner("b1")
    assert doubt(known, observation, state, memory) is None
    assert sigma_of(state, None).tolist() == [0, 0, 0]

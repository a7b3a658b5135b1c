"""Thresholds on the validation split: states that the net knows seldom raise an alarm."""

import jax
import numpy as np
import pytest

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import STATES, Dataset, papers_cloths
from clothkit.estimation.alarms import signs
from clothkit.estimation.refine import RefineConfig
from clothkit.estimation.support import fit
from clothkit.evaluation.alarms import set_alarms
from clothkit.evaluation.camera_settings import EvaluateCameraConfig, SetAlarmsConfig
from clothkit.models.net import Net
from clothkit.models.settings import VtMConfig
from clothkit.models.vtm import SUPPORT_LAYER, hidden_units, initial, seen_by
from clothkit.training.settings import TrainingConfig, TrainVtMConfig
from clothkit.training.vtm import example_units
from tests.observation.scenes import folded

CONFIG = VtMConfig(hidden=6)
NET = Net(CONFIG, initial(CONFIG, key=jax.random.key(0)))
TRAINED = TrainVtMConfig(net=CONFIG, training=TrainingConfig(batch=8), noise=0.0)


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Two training and five validation sequences of cloths folded over at random."""
    rng, count = np.random.default_rng(0), 7
    states = [[SQUARE.flat(), *(folded(along=rng.uniform(-0.1, 0.5)) for _ in range(3))] for _ in range(count)]
    return Dataset(
        np.array(states, np.float32),
        np.zeros((count, 4, 2), np.float32),
        np.zeros((count, 3, 6), np.float32),
        np.ones((count, 3), np.int8),
        np.full(count, 3, np.int8),
        np.array([0, 0, 1, 1, 1, 1, 1], np.int8),
        np.ones(count, bool),
        *papers_cloths(count),
    )


def test_hidden_units_are_those_of_the_layer_by_plain_products(dataset: Dataset) -> None:
    seen = np.asarray(seen_by(NET, dataset.vertices[:2, 1]))
    units = seen.reshape(2, -1).astype(np.float32)
    for i in range(SUPPORT_LAYER + 1):
        layer = NET.params[f"layer_{i + 1}"]
        units = np.tanh(units @ np.asarray(layer["kernel"]) + np.asarray(layer["bias"]))
    np.testing.assert_allclose(hidden_units(NET, seen), units, atol=1e-5)


def test_validation_states_seldom_raise_an_alarm_and_other_things_do(dataset: Dataset) -> None:
    settings = SetAlarmsConfig(share=0.2, sequences=4, conditions=())
    support = fit(example_units(NET, dataset.of_split("train"), TRAINED, examples=64, seed=0))
    camera, refinement = EvaluateCameraConfig(), RefineConfig(iterations=0)
    alarms = set_alarms(NET, dataset, settings, support=support, camera=camera, refinement=refinement)
    np.testing.assert_array_equal(alarms.cloths[0], dataset.of_split("train").cloth.min(axis=0))
    validation = dataset.of_split("validation")
    row, state = np.nonzero(np.arange(STATES) <= validation.length[:, None])
    truth, cloth = validation.vertices[row, state], validation.cloth[row]
    seen = np.asarray(seen_by(NET, truth))
    assert alarms.raised(signs(NET, alarms.support, seen, truth, cloth)).mean() <= 0.2
    full = np.ones_like(seen)
    assert alarms.raised(signs(NET, alarms.support, full, truth, cloth)).all()


def test_units_are_of_so_many_random_examples(dataset: Dataset) -> None:
    training = dataset.of_split("train")
    units, other = (example_units(NET, training, TRAINED, examples=20, seed=seed) for seed in (0, 1))
    assert units.shape == (20, 6)
    assert np.abs(units).max() < 1  # They are of a tanh.
    assert len(np.unique(units, axis=0)) > 10
    assert not np.array_equal(units, other)

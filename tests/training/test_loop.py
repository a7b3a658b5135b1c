"""Training: it learns, the paper's rate is halved when it should be, a killed run ends as an unbroken one."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from clothkit.models.settings import EMDVoxelConfig, PEMDConfig, Start, VtMConfig
from clothkit.runtime.errors import InputError
from clothkit.training import loop as loop
from clothkit.training.emd_voxel import train_emd_voxel
from clothkit.training.loop import Problem, train
from clothkit.training.pemd import problem, sequences, train_pemd
from clothkit.training.settings import TrainEMDVoxelConfig, TrainingConfig, TrainPEMDConfig, TrainVtMConfig
from clothkit.training.vtm import train_vtm

FAST = TrainingConfig(
    recipe="fast",
    iterations=60,
    batch=8,
    learning_rate=3e-3,
    muon_learning_rate=1e-2,
    validate_every=20,
    steps_per_call=10,
    start=Start(residual=0.3, output=0.1, sigma=-2.0),
)
PEMD = TrainPEMDConfig(net=PEMDConfig(latent=8, encoder=(24, 16), manipulation=12, decoder=(16, 24)), training=FAST)
VTM = TrainVtMConfig(net=VtMConfig(hidden=16), training=FAST, noise=0.01, noise_z_factor=0.2)
VOXEL = TrainEMDVoxelConfig(
    net=EMDVoxelConfig(latent=8, manipulation=12, dense=True, encoder=(16,), decoder=(16,)), training=FAST, noise=0.0
)


class Killed(Exception):
    """In place of a signal."""


def killed_at(monkeypatch, write):
    """Ends the next training right after its `write`-th checkpoint."""
    whole, count = loop.checkpoint.write, [0]

    def interrupted(*arguments):
        whole(*arguments)
        count[0] += 1
        if count[0] == write:
            raise Killed

    monkeypatch.setattr(loop.checkpoint, "write", interrupted)


def same(one, other):
    assert one.score == other.score
    assert one.history.equals(other.history)
    jax.tree.map(np.testing.assert_array_equal, one.params, other.params)


@pytest.mark.parametrize(("learn", "settings"), [(train_pemd, PEMD), (train_emd_voxel, VOXEL), (train_vtm, VTM)])
def test_fast_learns_and_a_killed_run_ends_as_an_unbroken_one(dataset, tmp_path, monkeypatch, learn, settings):
    def go(folder):
        (tmp_path / folder).mkdir(exist_ok=True)
        return learn(settings, dataset, dataset, work=tmp_path / folder, key=jax.random.key(0))

    unbroken = go("unbroken")
    losses = unbroken.history["loss" if learn is train_vtm else "loss_s"]
    assert list(unbroken.history["iteration"]) == [20, 40, 60]
    assert losses.is_monotonic_decreasing
    assert unbroken.score == unbroken.history["score"].min()
    with monkeypatch.context() as patch:
        killed_at(patch, 2)
        with pytest.raises(Killed):
            go("killed")
    same(go("killed"), unbroken)


def target_problem(scores):
    """A weight that is pushed up at every iteration; the scores are given."""
    given = iter(scores)
    return Problem(
        initial=lambda key: {"weight": jax.numpy.zeros(3)},
        gradient=lambda params, data, key: ({"weight": -jax.numpy.ones(3)}, {"loss": params["weight"].sum()}),
        validate=lambda params: {"score": next(given)},
    )


def test_paper_halves_the_rate_after_five_checks_without_improvement_and_keeps_the_best(tmp_path):
    paper = TrainingConfig(iterations=80, learning_rate=0.5, validate_every=10, steps_per_call=4)
    scores = [0.5, 0.4, 0.6, 0.6, 0.6, 0.6, 0.6, 0.6]
    trained = train(target_problem(scores), None, paper, work=tmp_path, key=jax.random.key(0))
    assert trained.score == 0.4
    np.testing.assert_allclose(trained.params["weight"], 20 * 0.5)
    assert list(trained.history["learning_rate"]) == [0.5] * 7 + [0.25]


def test_paper_stops_once_the_rate_is_small(tmp_path):
    paper = TrainingConfig(
        iterations=1000, learning_rate=0.5, validate_every=10, steps_per_call=10, patience=1, stop_below=0.2
    )
    trained = train(target_problem([0.3] * 100), None, paper, work=tmp_path, key=jax.random.key(0))
    assert trained.history["iteration"].iloc[-1] == 30


def test_a_loss_that_is_not_finite_ends_training_in_one_sentence(tmp_path):
    problem = replace(target_problem([1.0]), gradient=lambda p, data, key: (p, {"loss": jax.numpy.array(np.inf)}))
    settings = TrainingConfig(iterations=2, validate_every=2, steps_per_call=2)
    with pytest.raises(InputError, match="finite"):
        train(problem, None, settings, work=tmp_path, key=jax.random.key(0))


def test_paper_recipe_runs_from_end_to_end(dataset, tmp_path):
    paper = TrainingConfig(iterations=6, batch=4, learning_rate=1e-3, validate_every=3, steps_per_call=3)
    trained = train_pemd(replace(PEMD, training=paper), dataset, dataset, work=tmp_path, key=jax.random.key(0))
    assert {"iteration", "loss_s", "loss_p", "learning_rate", "score", "1/0", "3/0"} <= set(trained.history)


def cut(dataset, lengths):
    """The dataset with sequences of these lengths."""
    short = dataset.take(np.arange(len(lengths)))
    short.length[:] = lengths
    missing = np.arange(4) > short.length[:, None]
    short.vertices[missing] = short.centre[missing] = np.nan
    short.manipulation[missing[:, 1:]] = np.nan
    return short


@pytest.mark.parametrize("learn", [train_pemd, train_vtm])
def test_nets_learn_from_short_sequences(dataset, tmp_path, learn):
    settings = replace(PEMD if learn is train_pemd else VTM, training=replace(FAST, iterations=20))
    training, validation = cut(dataset, [1, 2, 2, 1]), cut(dataset, [2, 1])
    trained = learn(settings, training, validation, work=tmp_path, key=jax.random.key(0))
    assert np.isfinite(trained.score)
    assert np.isfinite(trained.history).all().all()
    tasks = set(trained.history) & {"1/0", "1/1", "1/2", "2/0", "2/1", "3/0"}
    assert tasks == ({"1/0", "1/1", "2/0"} if learn is train_pemd else set())


def test_the_score_counts_every_task_of_every_sequence(dataset):
    mixed = cut(dataset, [3, 1, 2])
    made = problem(PEMD, sequences(mixed))
    params = made.initial(jax.random.key(0))
    found = made.validate(params)
    alone = [problem(PEMD, sequences(mixed.take(slice(k, k + 1)))).validate(params) for k in range(3)]
    for task, places in (("1/0", [0, 1, 2]), ("1/1", [0, 2]), ("2/0", [0, 2]), ("1/2", [0]), ("3/0", [0])):
        assert found[task] == pytest.approx(np.mean([alone[place][task] for place in places]), rel=1e-5)
    assert "1/1" not in alone[1]
    assert found["score"] == pytest.approx(np.mean([value for name, value in found.items() if name != "score"]))

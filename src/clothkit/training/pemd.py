"""Training of pEM*D: examples, losses, validation and the training run (section 4.6, eq. 8)."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from clothkit.cloth import mesh as meshes
from clothkit.dataset.store import STEPS, Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.models.forward import ForwardModel, Rollout, forward_model, predict
from clothkit.models.pemd import initial
from clothkit.training import recipe
from clothkit.training.augment import Examples, as_shown, augment
from clothkit.training.devices import spread
from clothkit.training.likelihood import held_nll
from clothkit.training.loop import Problem, Trained, train
from clothkit.training.settings import TrainPEMDConfig


class Sequences(NamedTuple):
    """Recorded sequences as device arrays, sorted by length, the longest first [normalised]."""

    vertices: Float[Array, "sequences 4 u v 3"]
    centre: Float[Array, "sequences 4 2"]
    manipulation: Float[Array, "sequences 3 6"]
    length: Int[Array, " sequences"]
    cloth: Float[Array, "sequences 3"]
    at_least: Int[Array, " lengths"]
    """at_least[n]: number of sequences with n manipulations or more."""


def sequences(dataset: Dataset) -> Sequences:
    """A dataset's sequences as device arrays, sorted by length so that `draw` can choose among the long enough ones."""
    order = np.argsort(-dataset.length, kind="stable")
    at_least = [int(np.sum(dataset.length >= n)) for n in range(STEPS + 1)]
    return Sequences(
        vertices=jnp.asarray(dataset.vertices[order]),
        centre=jnp.asarray(dataset.centre[order]),
        manipulation=jnp.asarray(dataset.manipulation[order]),
        length=jnp.asarray(dataset.length[order].astype(np.int32)),
        cloth=jnp.asarray(dataset.cloth[order]),
        at_least=jnp.array(at_least),
    )


def draw(data: Sequences, n: int, batch: int, *, key: PRNGKeyArray) -> Examples:
    """A random batch of subsequences of n manipulations (design 6.5).

    Sequences are drawn uniformly among those that are long enough, and the start uniformly within each.
    """
    sequence_key, start_key = jax.random.split(key)
    sequence = jax.random.randint(sequence_key, (batch,), 0, data.at_least[n])
    start = jax.random.randint(start_key, (batch,), 0, data.length[sequence] - n + 1)
    states = start[:, None] + jnp.arange(n + 1)
    vertices = data.vertices[sequence[:, None], states]
    centre = data.centre[sequence[:, None], states]
    return Examples(
        state=vertices[:, 0],
        manipulations=data.manipulation[sequence[:, None], states[:, :-1]],
        outcomes=vertices[:, 1:],
        shifts=centre[:, 1:] - centre[:, :-1],
        cloth=data.cloth[sequence],
    )


def random_length(data: Sequences, *, key: PRNGKeyArray) -> Int[Array, ""]:
    """A random number of manipulations for a batch, uniform from 1 to the length of the longest sequence."""
    longest = jnp.sum(data.at_least[1:] > 0)
    return jax.random.randint(key, (), 1, longest + 1)


def losses(
    model: ForwardModel, params: PyTree, examples: Examples, *, hold: float = 0.0
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """loss_s and loss_p of section 4.6, from one prediction.

    loss_s, eq. (8), is `held_nll` with that `hold`, summed over the steps and averaged over the batch. loss_p is the
    mean squared error of the centre shifts [normalised squared].
    """
    predicted, found = predict(model, params, examples.state, examples.manipulations, cloth=examples.cloth, unroll=True)
    loss_s = jnp.mean(jnp.sum(held_nll(jnp.moveaxis(examples.outcomes, 1, 0), predicted, hold), axis=0))
    return loss_s, loss_position(found, examples)


def loss_position(found: Rollout, examples: Examples) -> Float[Array, ""]:
    """loss_p: mean squared error of the centre shifts [normalised squared] (section 4.6)."""
    return jnp.mean((found.shifts - jnp.moveaxis(examples.shifts, 1, 0)) ** 2)


def direction(
    model: ForwardModel, settings: TrainPEMDConfig, params: PyTree, examples: Examples
) -> tuple[PyTree, dict[str, Float[Array, ""]]]:
    """The gradient (or sign sum) that the optimiser takes, and the two losses by name: see `recipe.direction`."""
    model, examples = as_shown(model, examples)
    hold = settings.hold if settings.training.recipe == "fast" else 0.0
    return recipe.direction(
        lambda params: losses(model, params, examples, hold=hold),
        params,
        recipe=settings.training.recipe,
        shift_weight=settings.shift_weight,
    )


def task_errors(model: ForwardModel, params: PyTree, data: Sequences) -> Float[Array, "6 sequences"]:
    """Errors of the means predicted from true meshes, for the six tasks of each sequence [cloth length].

    NaN where a sequence is too short for the task.
    """
    errors = {}
    for start in range(STEPS):
        examples = Examples(
            state=data.vertices[:, start],
            manipulations=data.manipulation[:, start:],
            outcomes=data.vertices[:, start + 1 :],
            shifts=data.centre[:, start + 1 :] - data.centre[:, start:-1],
            cloth=data.cloth,
        )
        learner, examples = as_shown(model, examples)
        predicted, _ = predict(
            learner, params, examples.state, examples.manipulations, cloth=examples.cloth, unroll=True
        )
        truth = jnp.moveaxis(examples.outcomes, 1, 0)
        for i, error in enumerate(meshes.error(predicted.mean, truth, cloth=examples.cloth)):
            errors[start, i + 1] = error
    return jnp.stack([errors[task] for task in TASKS])


def _on_length(
    model: ForwardModel, settings: TrainPEMDConfig, n: int, params: PyTree, data: Sequences, key: PRNGKeyArray
) -> tuple[PyTree, dict[str, Any]]:
    draw_key, augment_key = jax.random.split(key)
    drawn = spread(draw(data, n, settings.training.batch, key=draw_key))
    examples = augment(drawn, noise=settings.noise, key=augment_key)
    return direction(model, settings, params, examples)


def problem(settings: TrainPEMDConfig, validation: Sequences) -> Problem:
    """The functions that the training loop needs for pEM*D; the training data are `Sequences`."""
    model = forward_model(settings.net)

    def gradient(params: PyTree, data: Sequences, key: PRNGKeyArray) -> tuple[PyTree, dict[str, Any]]:
        length_key, batch_key = jax.random.split(key)
        n = random_length(data, key=length_key)
        # `switch` runs only the branch of the drawn length.
        branches = [partial(_on_length, model, settings, length) for length in range(1, STEPS + 1)]
        return jax.lax.switch(n - 1, branches, params, data, batch_key)

    validate = validation_of_tasks(partial(task_errors, model), validation)
    return Problem(lambda key: initial(settings.net, settings.training.start, key=key), gradient, validate)


def validation_of_tasks(
    errors_of_tasks: Callable[[PyTree, Sequences], Float[Array, "6 sequences"]], validation: Sequences
) -> Callable[[PyTree], dict[str, float]]:
    """A function from weights to the mean error of each task, by the name `length/start`, and their mean, `score`.

    Tasks that no validation sequence is long enough for are left out.
    """
    # Sequences' lengths decide what counts, not NaN in the errors: a net that outputs NaN must not score better for it.
    counted = np.array(TASKS).sum(1)[:, None] <= np.asarray(validation.length)
    errors_of = jax.jit(
        lambda params, data: jnp.sum(jnp.where(counted, errors_of_tasks(params, data), 0), axis=1) / counted.sum(1)
    )

    def validate(params: PyTree) -> dict[str, float]:
        errors = np.asarray(errors_of(params, validation))
        present = counted.any(1)
        named = {f"{n}/{i}": float(e) for (i, n), e, some in zip(TASKS, errors, present, strict=True) if some}
        return {"score": float(errors[present].mean()), **named}

    return validate


def train_pemd(
    settings: TrainPEMDConfig, training: Dataset, validation: Dataset, *, work: Path, key: PRNGKeyArray
) -> Trained:
    """Train a forward model and return the weights with the best validation score.

    The score is the mean error over the six tasks, without those that no validation sequence is long enough for. An
    interrupted run resumes from the folder `work`.
    """
    return train(problem(settings, sequences(validation)), sequences(training), settings.training, work=work, key=key)

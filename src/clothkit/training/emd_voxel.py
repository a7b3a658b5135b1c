"""Training of the voxel EM*D: examples, losses, validation and the training run (section 6.2, design 6.15)."""

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from clothkit.cloth import voxels
from clothkit.dataset.store import STEPS, Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.manipulation.vector import swap_grasps
from clothkit.models.emd_voxel import cartesian, cross_entropy, initial
from clothkit.models.forward import ForwardModel, forward_model, predict
from clothkit.training import recipe
from clothkit.training.augment import Examples, as_shown, random_turns, turned
from clothkit.training.devices import spread
from clothkit.training.loop import Problem, Trained, train
from clothkit.training.pemd import Sequences, draw, loss_position, random_length, sequences, validation_of_tasks
from clothkit.training.settings import TrainEMDVoxelConfig


def voxelised(examples: Examples, *, noise: float, noise_z: float, key: PRNGKeyArray) -> Examples:
    """The examples with meshes converted to doubled, occluded voxels; noise is added to the input only."""
    before = jnp.concatenate([examples.state[:, None], examples.outcomes[:, :-1]], axis=1)
    if noise:
        seen = voxels.observe_noisily(examples.state, noise=noise, noise_z=noise_z, key=key)
    else:
        seen = voxels.observe(examples.state)
    return Examples(
        state=seen,
        manipulations=cartesian(before, examples.manipulations),
        outcomes=voxels.observe(examples.outcomes),
        shifts=examples.shifts,
        cloth=examples.cloth,
    )


def augment(examples: Examples, *, noise: float, noise_z: float, key: PRNGKeyArray) -> Examples:
    """Randomly transformed examples in voxels (section 4.6): meshes are rotated or mirrored before they are voxelised.

    The grasp points of each manipulation are swapped with probability 1/2. No equivalents are drawn, because voxels
    have no labels.
    """
    turn_key, swap_key, noise_key = jax.random.split(key, 3)
    batch, n = examples.manipulations.shape[:2]
    examples = turned(examples, random_turns(batch, key=turn_key))
    swap = jax.random.bernoulli(swap_key, shape=(batch, n, 1))
    manipulations = jnp.where(swap, swap_grasps(examples.manipulations), examples.manipulations)
    return voxelised(examples._replace(manipulations=manipulations), noise=noise, noise_z=noise_z, key=noise_key)


def losses(model: ForwardModel, params: PyTree, examples: Examples) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """loss_s and loss_p, from one prediction.

    loss_s is eq. (8) with binary cross-entropy instead of NLL, summed over the steps and averaged over the batch.
    """
    logits, found = predict(model, params, examples.state, examples.manipulations, unroll=True)
    loss_s = jnp.mean(jnp.sum(cross_entropy(logits, jnp.moveaxis(examples.outcomes, 1, 0)), axis=0))
    return loss_s, loss_position(found, examples)


def direction(
    model: ForwardModel, settings: TrainEMDVoxelConfig, params: PyTree, examples: Examples
) -> tuple[PyTree, dict[str, Float[Array, ""]]]:
    """The gradient (or sign sum) that the optimiser takes, and the two losses by name: see `recipe.direction`."""
    model, examples = as_shown(model, examples)
    return recipe.direction(
        lambda params: losses(model, params, examples),
        params,
        recipe=settings.training.recipe,
        shift_weight=settings.shift_weight,
    )


def task_differences(model: ForwardModel, params: PyTree, data: Sequences) -> Float[Array, "6 sequences"]:
    """Mean absolute voxel differences of predictions from noise-free voxels, for the six tasks of each sequence.

    The values are undefined where a sequence is too short for the task.
    """
    seen = voxels.observe(data.vertices)
    differences = {}
    for start in range(STEPS):
        examples = Examples(
            state=seen[:, start],
            manipulations=cartesian(data.vertices[:, start:STEPS], data.manipulation[:, start:]),
            outcomes=seen[:, start + 1 :],
            shifts=data.centre[:, start + 1 :] - data.centre[:, start:-1],
            cloth=data.cloth,
        )
        learner, examples = as_shown(model, examples)
        logits, _ = predict(learner, params, examples.state, examples.manipulations, unroll=True)
        truth = jnp.moveaxis(examples.outcomes, 1, 0)
        for i, difference in enumerate(jnp.mean(jnp.abs(jax.nn.sigmoid(logits) - truth), axis=(-3, -2, -1))):
            differences[start, i + 1] = difference
    return jnp.stack([differences[task] for task in TASKS])


def _on_length(
    model: ForwardModel, settings: TrainEMDVoxelConfig, n: int, params: PyTree, data: Sequences, key: PRNGKeyArray
) -> tuple[PyTree, dict[str, Any]]:
    draw_key, augment_key = jax.random.split(key)
    drawn = spread(draw(data, n, settings.training.batch, key=draw_key))
    noise_z = settings.noise * settings.noise_z_factor
    examples = augment(drawn, noise=settings.noise, noise_z=noise_z, key=augment_key)
    return direction(model, settings, params, examples)


def problem(settings: TrainEMDVoxelConfig, validation: Sequences) -> Problem:
    """The functions that the training loop needs for the voxel EM*D; the training data are `Sequences`."""
    model = forward_model(settings.net)

    def gradient(params: PyTree, data: Sequences, key: PRNGKeyArray) -> tuple[PyTree, dict[str, Any]]:
        length_key, batch_key = jax.random.split(key)
        n = random_length(data, key=length_key)
        # `switch` runs only the branch of the drawn length.
        branches = [partial(_on_length, model, settings, length) for length in range(1, STEPS + 1)]
        return jax.lax.switch(n - 1, branches, params, data, batch_key)

    validate = validation_of_tasks(partial(task_differences, model), validation)
    return Problem(lambda key: initial(settings.net, settings.training.start, key=key), gradient, validate)


def train_emd_voxel(
    settings: TrainEMDVoxelConfig, training: Dataset, validation: Dataset, *, work: Path, key: PRNGKeyArray
) -> Trained:
    """Train a voxel EM*D and return the weights with the best validation score.

    The score is the mean absolute voxel difference over the six tasks, without those that no validation sequence is
    long enough for. An interrupted run resumes from the folder `work`.
    """
    return train(problem(settings, sequences(validation)), sequences(training), settings.training, work=work, key=key)

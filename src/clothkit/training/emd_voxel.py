"""Training of the voxel EM*D: examples, losses, validation and the training run (section 6.2, design 6.15)."""

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray, PyTree

from clothkit.cloth import voxels
from clothkit.dataset.store import STEPS, Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.manipulation.turns import turn
from clothkit.manipulation.vector import swap_grasps
from clothkit.models.canonical import cartesian_described, voxel_frame, voxels_described
from clothkit.models.emd_voxel import EMDVoxel, cartesian, cross_entropy, initial
from clothkit.models.layers import run
from clothkit.training import recipe
from clothkit.training.augment import Examples, random_turns, turned
from clothkit.training.devices import spread
from clothkit.training.loop import Problem, Trained, train
from clothkit.training.pemd import Sequences, draw, random_length, sequences, validation_of_tasks
from clothkit.training.settings import TrainEMDVoxelConfig


class VoxelExamples(NamedTuple):
    """A batch of subsequences of n manipulations: inputs and targets of the voxel EM*D."""

    voxels: Bool[Array, "batch 32 32 16"]
    """The observed first state: the input."""
    manipulations: Float[Array, "batch n 6"]
    """Cartesian [normalised]."""
    outcomes: Bool[Array, "batch n 32 32 16"]
    """The state after each manipulation, centred."""
    shifts: Float[Array, "batch n 2"]
    """The displacement of the cloth's centre by each manipulation [normalised]."""


def voxelised(examples: Examples, *, noise: float, noise_z: float, key: PRNGKeyArray) -> VoxelExamples:
    """The examples with meshes converted to doubled, occluded voxels; noise is added to the input only."""
    before = jnp.concatenate([examples.mesh[:, None], examples.outcomes[:, :-1]], axis=1)
    if noise:
        seen = voxels.observe_noisily(examples.mesh, noise=noise, noise_z=noise_z, key=key)
    else:
        seen = voxels.observe(examples.mesh)
    return VoxelExamples(
        voxels=seen,
        manipulations=cartesian(before, examples.manipulations),
        outcomes=voxels.observe(examples.outcomes),
        shifts=examples.shifts,
    )


def augment(examples: Examples, *, noise: float, noise_z: float, key: PRNGKeyArray) -> VoxelExamples:
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


def described(examples: VoxelExamples) -> VoxelExamples:
    """The examples, each transformed to the canonical description of its first state."""
    found = voxel_frame(examples.voxels)
    per_step = jax.tree.map(lambda part: jnp.repeat(part[:, None], examples.shifts.shape[1], axis=1), found)
    return VoxelExamples(
        voxels=voxels_described(examples.voxels, found),
        manipulations=cartesian_described(examples.manipulations, per_step),
        outcomes=voxels_described(examples.outcomes, per_step),
        shifts=turn(examples.shifts, per_step.matrix),
    )


def loss_shape(net: EMDVoxel, params: PyTree, examples: VoxelExamples) -> Float[Array, ""]:
    """loss_s, eq. (8) with binary cross-entropy instead of NLL, summed over the steps and averaged over the batch."""
    logits, _, _ = run(net, params, examples.voxels, examples.manipulations)
    return jnp.mean(jnp.sum(cross_entropy(logits, jnp.moveaxis(examples.outcomes, 1, 0)), axis=0))


def loss_position(net: EMDVoxel, params: PyTree, examples: VoxelExamples) -> Float[Array, ""]:
    """loss_p: mean squared error of the centre shifts [normalised squared] (section 4.6)."""
    _, _, shifts = run(net, params, examples.voxels, examples.manipulations, method="unroll")
    return jnp.mean((shifts - jnp.moveaxis(examples.shifts, 1, 0)) ** 2)


def direction(
    net: EMDVoxel, settings: TrainEMDVoxelConfig, params: PyTree, examples: VoxelExamples
) -> tuple[PyTree, dict[str, Float[Array, ""]]]:
    """The gradient (or sign sum) that the optimiser takes, and the two losses by name: see `recipe.direction`."""
    return recipe.direction(
        lambda params: loss_shape(net, params, examples),
        lambda params: loss_position(net, params, examples),
        params,
        recipe=settings.training.recipe,
        shift_weight=settings.shift_weight,
    )


def task_differences(net: EMDVoxel, params: PyTree, data: Sequences) -> Float[Array, "6 sequences"]:
    """Mean absolute voxel differences of predictions from noise-free voxels, for the six tasks of each sequence.

    The values are undefined where a sequence is too short for the task.
    """
    seen = voxels.observe(data.vertices)
    differences = {}
    for start in range(STEPS):
        examples = VoxelExamples(
            voxels=seen[:, start],
            manipulations=cartesian(data.vertices[:, start:STEPS], data.manipulation[:, start:]),
            outcomes=seen[:, start + 1 :],
            shifts=data.centre[:, start + 1 :] - data.centre[:, start:-1],
        )
        if net.config.canonical:
            examples = described(examples)
        logits, _, _ = run(net, params, examples.voxels, examples.manipulations)
        truth = jnp.moveaxis(examples.outcomes, 1, 0)
        for i, difference in enumerate(jnp.mean(jnp.abs(jax.nn.sigmoid(logits) - truth), axis=(-3, -2, -1))):
            differences[start, i + 1] = difference
    return jnp.stack([differences[task] for task in TASKS])


def _on_length(
    net: EMDVoxel, settings: TrainEMDVoxelConfig, n: int, params: PyTree, data: Sequences, key: PRNGKeyArray
) -> tuple[PyTree, dict[str, Any]]:
    draw_key, augment_key = jax.random.split(key)
    drawn = spread(draw(data, n, settings.training.batch, key=draw_key))
    noise_z = settings.noise * settings.noise_z_factor
    seen = augment(drawn, noise=settings.noise, noise_z=noise_z, key=augment_key)
    if settings.net.canonical:
        seen = described(seen)
    return direction(net, settings, params, seen)


def problem(settings: TrainEMDVoxelConfig, validation: Sequences) -> Problem:
    """The functions that the training loop needs for the voxel EM*D; the training data are `Sequences`."""
    net = EMDVoxel(settings.net, settings.training.start)

    def gradient(params: PyTree, data: Sequences, key: PRNGKeyArray) -> tuple[PyTree, dict[str, Any]]:
        length_key, batch_key = jax.random.split(key)
        n = random_length(data, key=length_key)
        # `switch` runs only the branch of the drawn length.
        branches = [partial(_on_length, net, settings, length) for length in range(1, STEPS + 1)]
        return jax.lax.switch(n - 1, branches, params, data, batch_key)

    validate = validation_of_tasks(partial(task_differences, net), validation)
    return Problem(lambda key: initial(settings.net, settings.training.start, key=key), gradient, validate)


def train_emd_voxel(
    settings: TrainEMDVoxelConfig, training: Dataset, validation: Dataset, *, work: Path, key: PRNGKeyArray
) -> Trained:
    """Train a voxel EM*D and return the weights with the best validation score.

    The score is the mean absolute voxel difference over the six tasks, without those that no validation sequence is
    long enough for. An interrupted run resumes from the folder `work`.
    """
    return train(problem(settings, sequences(validation)), sequences(training), settings.training, work=work, key=key)

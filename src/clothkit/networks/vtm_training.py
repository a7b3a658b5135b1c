"""What VtM learns: a mesh, under any of its eight labellings, from noisy voxels of it (section 4.8, eq. 12)."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray, PyTree

from clothkit.cloth import mesh as meshes
from clothkit.cloth import voxels
from clothkit.cloth.equivalents import equivalents, relabel_batch
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.dataset.store import STEPS, Dataset
from clothkit.manipulation.turns import turn_mesh
from clothkit.networks.augment import random_turns
from clothkit.networks.devices import spread
from clothkit.networks.layers import run
from clothkit.networks.likelihood import held_nll
from clothkit.networks.settings import TrainVtMConfig
from clothkit.networks.training import Problem, Trained, train
from clothkit.networks.vtm import VtM, initial


class States(NamedTuple):
    """Single states on the device, centred [normalised]."""

    folded: Float[Array, "states u v 3"]
    flat: Float[Array, "u v 3"]


def states(dataset: Dataset) -> States:
    """The states of a dataset that follow a manipulation, and the flat one."""
    follows = np.arange(STEPS + 1) <= dataset.length[:, None]
    follows[:, 0] = False
    return States(jnp.asarray(dataset.vertices[follows]), jnp.asarray(dataset.vertices[0, 0]))


def draw(data: States, settings: TrainVtMConfig, *, key: PRNGKeyArray) -> Float[Array, "batch u v 3"]:
    """A batch of states, turned and mirrored at random."""
    state_key, flat_key, turn_key = jax.random.split(key, 3)
    batch = settings.training.batch
    chosen = data.folded[jax.random.randint(state_key, (batch,), 0, data.folded.shape[0])]
    is_flat = jax.random.bernoulli(flat_key, settings.flat, (batch, 1, 1, 1))
    return turn_mesh(jnp.where(is_flat, data.flat, chosen), random_turns(batch, key=turn_key))


def observed(
    mesh: Float[Array, "batch u v 3"], settings: TrainVtMConfig, *, key: PRNGKeyArray
) -> Bool[Array, "batch 32 32 16"]:
    """Training input: doubled, duplicated with noise, occluded; without noise two copies are one."""
    if settings.noise == 0:
        return voxels.observe(mesh, height=settings.height)
    noise_z = settings.noise * settings.noise_z_factor
    return voxels.observe_noisily(mesh, noise=settings.noise, noise_z=noise_z, height=settings.height, key=key)


def loss_vtm(
    mesh: Float[Array, "batch u v 3"], estimate: ProbabilisticMesh, *, hold: float = 0.0
) -> Float[Array, " batch"]:
    """Eq. (12): the negative log likelihood under the labelling that makes it least (`hold`: held_nll)."""
    # Choosing first keeps the eight candidates out of the backward pass; the gradient of the minimum is the same.
    likelihoods = jax.lax.stop_gradient(meshes.nll(equivalents(mesh), estimate))
    return held_nll(relabel_batch(mesh, jnp.argmin(likelihoods, axis=0)), estimate, hold)


def state_errors(
    net: VtM, params: PyTree, mesh: Float[Array, "batch u v 3"], *, height: float
) -> Float[Array, " batch"]:
    """Errors of the estimated means, from noise-free voxels [cloth length]."""
    estimate = run(net, params, voxels.observe(mesh, height=height))
    return meshes.error(estimate.mean, mesh)


def problem(settings: TrainVtMConfig, validation: Dataset) -> Problem:
    """VtM's part of the training loop; its data are `States`."""
    net = VtM(settings.net, settings.training.start)

    def gradient(params: PyTree, data: States, key: PRNGKeyArray) -> tuple[PyTree, dict[str, Any]]:
        draw_key, noise_key = jax.random.split(key)
        mesh = spread(draw(data, settings, key=draw_key))
        seen = observed(mesh, settings, key=noise_key)

        def loss(params: PyTree) -> Float[Array, ""]:
            return jnp.mean(loss_vtm(mesh, run(net, params, seen), hold=settings.hold))

        value, gradient = jax.value_and_grad(loss)(params)
        return gradient, {"loss": value}

    errors_of = jax.jit(lambda params, mesh: state_errors(net, params, mesh, height=settings.height))
    longest = int(validation.length.max())
    by_step = [jnp.asarray(validation.vertices[validation.length >= i, i]) for i in range(longest + 1)]

    def validate(params: PyTree) -> dict[str, float]:
        errors = [float(errors_of(params, mesh).mean()) for mesh in by_step]
        return {"score": float(np.mean(errors[1:])), **{f"step_{i}": error for i, error in enumerate(errors)}}

    return Problem(lambda key: initial(settings.net, settings.training.start, key=key), gradient, validate)


def train_vtm(
    settings: TrainVtMConfig, training: Dataset, validation: Dataset, *, work: Path, key: PRNGKeyArray
) -> Trained:
    """A VtM of the best validation score, going on from `work` after a kill.

    The score is the mean error over steps 1 to 3, of those that some validation sequence has.
    """
    return train(problem(settings, validation), states(training), settings.training, work=work, key=key)

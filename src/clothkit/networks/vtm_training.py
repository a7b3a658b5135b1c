"""What VtM learns: a mesh, under any of its eight labellings, from noisy voxels of it (section 4.8, eq. 12).

The first layer is more than half of the products, and most voxels are hardly ever occupied: those far from the centre,
and high up. Training can leave them out (`rare`); the trained net takes all voxels, and gives these weights of zero.
"""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, PyTree, Shaped

from clothkit.cloth import mesh as meshes
from clothkit.cloth import voxels
from clothkit.cloth.equivalents import SWAP, equivalents, relabel_batch
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.dataset.store import STEPS, Dataset
from clothkit.errors import InputError
from clothkit.manipulation.turns import turn_mesh
from clothkit.networks.augment import random_turns
from clothkit.networks.canonical import lies_along_y
from clothkit.networks.devices import spread
from clothkit.networks.layers import run
from clothkit.networks.likelihood import held_nll
from clothkit.networks.settings import TrainVtMConfig, VtMConfig
from clothkit.networks.training import Problem, Trained, train
from clothkit.networks.vtm import VtM, initial, turned

EVERY = np.arange(np.prod(voxels.RESOLUTION))
"""All voxels, by their places in a flat array."""

COUNTED = 8192
"""Examples by which rare voxels are told, at least."""


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
        return voxels.observe(mesh, height=settings.net.height)
    noise_z = settings.noise * settings.noise_z_factor
    return voxels.observe_noisily(mesh, noise=settings.noise, noise_z=noise_z, height=settings.net.height, key=key)


def shown(
    mesh: Float[Array, "batch u v 3"], seen: Bool[Array, "batch x y z"], net: VtMConfig
) -> tuple[Float[Array, "batch u v 3"], Bool[Array, "batch x y z"]]:
    """An example as the net is shown it: to a canonical net the voxels lie widest along x, and the mesh with them."""
    if not net.canonical:
        return mesh, seen
    swap = lies_along_y(seen) * SWAP
    return turned(mesh, swap), relabel_batch(seen, swap)


def loss_vtm(
    mesh: Float[Array, "batch u v 3"], estimate: ProbabilisticMesh, *, hold: float = 0.0
) -> Float[Array, " batch"]:
    """Eq. (12): the negative log likelihood under the labelling that makes it least (`hold`: held_nll)."""
    # Choosing first keeps the eight candidates out of the backward pass; the gradient of the minimum is the same.
    likelihoods = jax.lax.stop_gradient(meshes.nll(equivalents(mesh), estimate))
    return held_nll(relabel_batch(mesh, jnp.argmin(likelihoods, axis=0)), estimate, hold)


def among(chosen: Int[np.ndarray, " voxels"], seen: Shaped[Array, "batch x y z"]) -> Shaped[Array, "batch voxels 1 1"]:
    """The chosen of the voxels, as the narrowed net takes them."""
    flat = seen.reshape(len(seen), -1)
    return (flat if len(chosen) == len(EVERY) else flat[:, chosen])[..., None, None]


def narrowed(params: PyTree, chosen: Int[np.ndarray, " voxels"]) -> PyTree:
    """Weights of a net that takes the chosen voxels alone."""
    first = params["layer_1"]
    return {**params, "layer_1": {**first, "kernel": first["kernel"][chosen]}}


def widened(params: PyTree, chosen: Int[np.ndarray, " voxels"]) -> PyTree:
    """A narrowed net's weights as those of a net that takes all voxels; what it did not take has weight zero."""
    first = params["layer_1"]
    kernel = jnp.zeros((len(EVERY), first["kernel"].shape[1])).at[chosen].set(first["kernel"])
    return {**params, "layer_1": {**first, "kernel": kernel}}


def taken(data: States, settings: TrainVtMConfig) -> Int[np.ndarray, " voxels"]:
    """The voxels that are not too rare: occupied in more than a share `rare` of examples such as training draws.

    As places in a flat array. Raises InputError when none is left.
    """
    if settings.rare == 0:
        return EVERY

    @jax.jit
    def occupied(data: States, key: PRNGKeyArray) -> Float[Array, "x y z"]:
        draw_key, noise_key = jax.random.split(key)
        mesh = draw(data, settings, key=draw_key)
        return jnp.mean(shown(mesh, observed(mesh, settings, key=noise_key), settings.net)[1], axis=0)

    batches = -(-COUNTED // settings.training.batch)
    shares = np.mean([occupied(data, key) for key in jax.random.split(jax.random.key(0), batches)], axis=0)
    chosen = np.flatnonzero(shares > settings.rare)
    if not len(chosen):
        raise InputError(f"train_vtm.rare: {settings.rare} leaves no voxels, the commonest has {shares.max():.3g}")
    return chosen


def problem(settings: TrainVtMConfig, validation: Dataset, chosen: Int[np.ndarray, " voxels"] = EVERY) -> Problem:
    """VtM's part of the training loop; its data are `States`, its weights those of a narrowed net."""
    net = VtM(settings.net, settings.training.start)

    def estimated(params: PyTree, seen: Bool[Array, "batch x y z"]) -> ProbabilisticMesh:
        return run(net, params, among(chosen, seen))

    def gradient(params: PyTree, data: States, key: PRNGKeyArray) -> tuple[PyTree, dict[str, Any]]:
        draw_key, noise_key = jax.random.split(key)
        mesh = spread(draw(data, settings, key=draw_key))
        mesh, seen = shown(mesh, observed(mesh, settings, key=noise_key), settings.net)

        def loss(params: PyTree) -> Float[Array, ""]:
            return jnp.mean(loss_vtm(mesh, estimated(params, seen), hold=settings.hold))

        value, gradient = jax.value_and_grad(loss)(params)
        return gradient, {"loss": value}

    @jax.jit
    def errors_of(params: PyTree, mesh: Float[Array, "batch u v 3"]) -> Float[Array, " batch"]:
        mesh, seen = shown(mesh, voxels.observe(mesh, height=settings.net.height), settings.net)
        return meshes.error(estimated(params, seen).mean, mesh)

    longest = int(validation.length.max())
    by_step = [jnp.asarray(validation.vertices[validation.length >= i, i]) for i in range(longest + 1)]

    def validate(params: PyTree) -> dict[str, float]:
        errors = [float(errors_of(params, mesh).mean()) for mesh in by_step]
        return {"score": float(np.mean(errors[1:])), **{f"step_{i}": error for i, error in enumerate(errors)}}

    def start(key: PRNGKeyArray) -> PyTree:
        return narrowed(initial(settings.net, settings.training.start, key=key), chosen)

    return Problem(start, gradient, validate)


def train_vtm(
    settings: TrainVtMConfig, training: Dataset, validation: Dataset, *, work: Path, key: PRNGKeyArray
) -> Trained:
    """A VtM of the best validation score, going on from `work` after a kill.

    The score is the mean error over steps 1 to 3, of those that some validation sequence has.
    """
    data = states(training)
    chosen = taken(data, settings)
    trained = train(problem(settings, validation, chosen), data, settings.training, work=work, key=key)
    return dataclasses.replace(trained, params=widened(trained.params, chosen))

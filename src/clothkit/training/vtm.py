"""Training of VtM: the mesh, in any of its eight labellings, is learnt from its noisy voxels (section 4.8, eq. 12).

The first layer takes more than half of the multiplications, but most voxels, which are far from the centre or high
above the table, are hardly ever occupied. Training can leave these out (`rare`). The trained net takes all voxels; the
weights of those that were left out are zero.
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
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import among_equal_labellings, equivalents, relabel_batch
from clothkit.cloth.topology import SQUARE, SWAP
from clothkit.dataset.store import STEPS, Dataset
from clothkit.manipulation.turns import turn_mesh
from clothkit.models.canonical import lies_along_y
from clothkit.models.hypotheses import Hypotheses, most_probable, ordered
from clothkit.models.layers import run
from clothkit.models.net import Net
from clothkit.models.settings import VtMConfig
from clothkit.models.vtm import VtM, hidden_units, initial, turned
from clothkit.runtime.errors import InputError
from clothkit.simulation.settings import STARTS
from clothkit.training.augment import random_turns
from clothkit.training.devices import spread
from clothkit.training.likelihood import held_nll
from clothkit.training.loop import Problem, Trained, train
from clothkit.training.settings import CameraNoise, TrainVtMConfig

EVERY = np.arange(np.prod(voxels.RESOLUTION))
"""Indices of all voxels in a flattened volume."""

COUNTED = 8192
"""Least number of examples from which the rare voxels are determined."""


RELAXED = 0.05
"""Share of the loss that all hypotheses have in common."""

CHOICE = 0.01
"""Weight of the probabilities' cross entropy, in units of a likelihood that is averaged over all coordinates."""


class States(NamedTuple):
    """Single states as device arrays, centred [normalised]."""

    folded: Float[Array, "states u v 3"]
    """All that are not flat, as far as they were recorded."""
    sequence: Int[Array, " states"]
    """Which row of the cloths each one is of."""
    flat: Float[Array, "cloths u v 3"]
    """Each sequence's cloth, flat."""
    cloth: Float[Array, "cloths 3"]
    """Sides and thickness of each sequence's cloth."""


def states(dataset: Dataset) -> States:
    """The states of a dataset that are not flat, and its cloths when they are flat."""
    folded = np.arange(STEPS + 1) <= dataset.length[:, None]
    folded[:, 0] = dataset.start != STARTS.index("flat")
    flat = np.where(folded[:, 0, None, None, None], _flat(dataset.cloth), dataset.vertices[:, 0])
    found = (dataset.vertices[folded], np.nonzero(folded)[0], flat, dataset.cloth)
    return States(*(jnp.asarray(part) for part in found))


def _flat(cloth: Float[np.ndarray, "cloths 3"]) -> Float[np.ndarray, "cloths u v 3"]:
    """Cloths with these sides and thicknesses, flat on the table: their vertices lie in their middle."""
    uv = SQUARE.geodesic() * cloth[:, None, None, :2] / 2
    z = np.broadcast_to(cloth[:, None, None, 2:] / 2, (*uv.shape[:-1], 1))
    return np.concatenate([uv, z], axis=-1).astype(np.float32)


def draw(
    data: States, settings: TrainVtMConfig, *, key: PRNGKeyArray
) -> tuple[Float[Array, "batch u v 3"], Float[Array, "batch 3"]]:
    """A random batch of states, rotated and mirrored at random, and their cloths; a share `settings.flat` is flat."""
    state_key, flat_key, turn_key = jax.random.split(key, 3)
    batch = settings.training.batch
    row = jax.random.randint(state_key, (batch,), 0, data.folded.shape[0])
    is_flat = jax.random.bernoulli(flat_key, settings.flat, (batch, 1, 1, 1))
    sequence = data.sequence[row]
    mesh = jnp.where(is_flat, data.flat[sequence], data.folded[row])
    return turn_mesh(mesh, random_turns(batch, key=turn_key)), data.cloth[sequence]


def observed(
    mesh: Float[Array, "batch u v 3"], settings: TrainVtMConfig, *, key: PRNGKeyArray
) -> Bool[Array, "batch 32 32 16"]:
    """Training inputs: doubled, duplicated with noise and occluded voxels. Without noise, duplicates are not needed."""
    if settings.camera is not None:
        return by_camera(mesh, settings.camera, settings.net.viewport, key=key)
    if settings.noise == 0:
        return voxels.observe(mesh, viewport=settings.net.viewport)
    noise_z = settings.noise * settings.noise_z_factor
    return voxels.observe_noisily(mesh, noise=settings.noise, noise_z=noise_z, viewport=settings.net.viewport, key=key)


def displaced(
    mesh: Float[Array, "batch u v 3"], settings: TrainVtMConfig, *, key: PRNGKeyArray
) -> Float[Array, "batch u v 3"]:
    """Meshes about the centres that a camera observes."""
    if settings.camera is None:
        return mesh
    shift = settings.camera.shift * jax.random.normal(key, (len(mesh), 1, 1, 2))
    return mesh.at[..., :2].add(shift)


def by_camera(
    mesh: Float[Array, "batch u v 3"], camera: CameraNoise, viewport: voxels.Viewport, *, key: PRNGKeyArray
) -> Bool[Array, "batch 32 32 16"]:
    """The voxels of meshes as a depth camera above shows them: doubled, with noise, tilt, steps and holes, occluded."""
    point_key, bias_key, hole_key, radius_key, count_key, share_key, missing_key = jax.random.split(key, 7)
    points = voxels.double(mesh).reshape(len(mesh), -1, 3)
    batch, count = points.shape[:2]
    centre = jnp.take_along_axis(points, jax.random.randint(hole_key, (batch, camera.holes, 1), 0, count), axis=1)
    radius = camera.radius * jax.random.uniform(radius_key, (batch, camera.holes))
    number = jax.random.randint(count_key, (batch, 1), 0, camera.holes + 1)
    radius = jnp.where(jnp.arange(camera.holes) < number, radius, 0.0)
    away = jnp.linalg.norm(points[:, :, None, :2] - centre[:, None, :, :2], axis=-1)
    share = camera.missing * jax.random.uniform(share_key, (batch, 1))
    gone = jnp.any(away < radius[:, None], axis=-1) | jax.random.bernoulli(missing_key, share, (batch, count))
    noise = camera.noise * jax.random.normal(point_key, points.shape)
    noise = noise.at[..., 2].add(camera.bias * jax.random.normal(bias_key, (batch, 1)))
    slope_key, step_key, begin_key = jax.random.split(jax.random.fold_in(key, 1), 3)
    slope = camera.tilt * jax.random.normal(slope_key, (batch, 1, 2))
    found = points + noise
    found = found.at[..., 2].add(jnp.sum(slope * found[..., :2], axis=-1))
    step = camera.step * jax.random.uniform(step_key, (batch, 1))
    found = found.at[..., 2].set(stepped(found[..., 2], step, jax.random.uniform(begin_key, (batch, 1))))
    # Points outside the viewport are dropped.
    seen = jnp.where(gone[..., None], 2.0, found)
    return voxels.occlude(voxels.voxelise(seen, viewport=viewport))


def stepped(
    z: Float[Array, "batch points"], step: Float[Array, "batch 1"], begin: Float[Array, "batch 1"]
) -> Float[Array, "batch points"]:
    """Heights rounded to whole steps from `begin` steps on; a step of 0 leaves them as they are."""
    size = jnp.maximum(step, 1e-9)
    return jnp.where(step > 0, size * (jnp.round(z / size - begin) + begin), z)


def shown(
    mesh: Float[Array, "batch u v 3"], seen: Bool[Array, "batch x y z"], net: VtMConfig
) -> tuple[Float[Array, "batch u v 3"], Bool[Array, "batch x y z"]]:
    """Examples as the net takes them. For a canonical net, voxels and mesh are turned to be widest along x."""
    if not net.canonical:
        return mesh, seen
    swap = lies_along_y(seen) * SWAP
    return turned(mesh, swap), relabel_batch(seen, swap)


def drawn(
    data: States, settings: TrainVtMConfig, *, key: PRNGKeyArray
) -> tuple[Float[Array, "batch u v 3"], Bool[Array, "batch x y z"], Float[Array, "batch 3"]]:
    """A random batch of training examples as the net takes them: meshes, voxels and cloths."""
    draw_key, noise_key = jax.random.split(key)
    mesh, cloth = spread(draw(data, settings, key=draw_key))
    mesh = displaced(mesh, settings, key=jax.random.fold_in(noise_key, 1))
    return *shown(mesh, observed(mesh, settings, key=noise_key), settings.net), cloth


def loss_vtm(
    mesh: Float[Array, "batch u v 3"],
    estimate: ProbabilisticMesh,
    *,
    cloth: Float[Array, "batch 3"] | None = None,
    hold: float = 0.0,
) -> Float[Array, " batch"]:
    """Eq. (12): the negative log likelihood (`held_nll` with that `hold`) for the most likely labelling of the mesh.

    With `cloth`, its sides and thickness, only labellings that keep its sides count.
    """
    # Choosing the labelling first keeps the other seven out of the backward pass; the gradient is the same.
    likelihoods = jax.lax.stop_gradient(meshes.nll(equivalents(mesh), estimate))
    if cloth is not None:
        likelihoods = among_equal_labellings(likelihoods, cloth)
    return held_nll(relabel_batch(mesh, jnp.argmin(likelihoods, axis=0)), estimate, hold)


def loss_hypotheses(
    mesh: Float[Array, "batch u v 3"],
    found: Hypotheses,
    *,
    cloth: Float[Array, "batch 3"] | None = None,
    hold: float = 0.0,
) -> Float[Array, " batch"]:
    """`loss_vtm` of each example's nearest hypothesis, and the cross entropy of the probabilities with which one it is.

    The others learn a little, too (RELAXED), so that none is left without examples (Rupprecht et al., "Learning in an
    uncertain world", ICCV 2017). The nearest one counts and not the most likely one, because the hypothesis that was
    right before has the smaller standard deviations, and would take all examples.
    """
    count = found.probability.shape[-1]
    parts = [ProbabilisticMesh(*(part[..., i, :, :, :] for part in found.mesh)) for i in range(count)]
    each = jnp.stack([loss_vtm(mesh, part, cloth=cloth, hold=hold) for part in parts], axis=-1)
    if count == 1:
        return each[..., 0]
    away = jnp.stack([meshes.error(jax.lax.stop_gradient(part.mean), mesh, cloth=cloth) for part in parts], axis=-1)
    is_best = jax.nn.one_hot(jnp.argmin(away, axis=-1), count)
    share = (1 - RELAXED) * is_best + RELAXED / count
    return jnp.sum(share * each - CHOICE * is_best * jnp.log(found.probability + 1e-9), axis=-1)


def among(chosen: Int[np.ndarray, " voxels"], seen: Shaped[Array, "batch x y z"]) -> Shaped[Array, "batch voxels 1 1"]:
    """The chosen voxels only, in the input shape of a net with narrowed weights."""
    flat = seen.reshape(len(seen), -1)
    return (flat if len(chosen) == len(EVERY) else flat[:, chosen])[..., None, None]


def narrowed(params: PyTree, chosen: Int[np.ndarray, " voxels"]) -> PyTree:
    """The weights without those of the first layer for voxels that are not chosen."""
    first = params["layer_1"]
    # Inputs after the voxels tell of the cloth.
    kept = np.concatenate([chosen, np.arange(len(EVERY), len(first["kernel"]))])
    return {**params, "layer_1": {**first, "kernel": first["kernel"][kept]}}


def widened(params: PyTree, chosen: Int[np.ndarray, " voxels"]) -> PyTree:
    """The inverse of `narrowed`: weights for all voxels, with zeros for those that were not chosen."""
    first = params["layer_1"]
    narrow = first["kernel"]
    voxels = jnp.zeros((len(EVERY), narrow.shape[1])).at[chosen].set(narrow[: len(chosen)])
    kernel = jnp.concatenate([voxels, narrow[len(chosen) :]])
    return {**params, "layer_1": {**first, "kernel": kernel}}


def taken(data: States, settings: TrainVtMConfig) -> Int[np.ndarray, " voxels"]:
    """Indices in a flattened volume of the voxels occupied in more than a share `rare` of random training examples.

    Raises InputError if there are none.
    """
    if settings.rare == 0:
        return EVERY

    @jax.jit
    def occupied(data: States, key: PRNGKeyArray) -> Float[Array, "x y z"]:
        return jnp.mean(drawn(data, settings, key=key)[1], axis=0)

    batches = -(-COUNTED // settings.training.batch)
    shares = np.mean([occupied(data, key) for key in jax.random.split(jax.random.key(0), batches)], axis=0)
    chosen = np.flatnonzero(shares > settings.rare)
    if not len(chosen):
        raise InputError(f"train_vtm.rare: {settings.rare} leaves no voxels, the commonest has {shares.max():.3g}")
    return chosen


def problem(settings: TrainVtMConfig, validation: Dataset, chosen: Int[np.ndarray, " voxels"] = EVERY) -> Problem:
    """The functions that the training loop needs for VtM; the training data are `States`, the weights are narrowed."""
    net = VtM(settings.net, settings.training.start)

    def estimated(params: PyTree, seen: Bool[Array, "batch x y z"], cloth: Float[Array, "batch 3"]) -> Hypotheses:
        return run(net, params, among(chosen, seen), cloth)

    def gradient(params: PyTree, data: States, key: PRNGKeyArray) -> tuple[PyTree, dict[str, Any]]:
        mesh, seen, cloth = drawn(data, settings, key=key)

        def loss(params: PyTree) -> Float[Array, ""]:
            return jnp.mean(loss_hypotheses(mesh, estimated(params, seen, cloth), cloth=cloth, hold=settings.hold))

        value, gradient = jax.value_and_grad(loss)(params)
        return gradient, {"loss": value}

    @jax.jit
    def errors_of(
        params: PyTree, mesh: Float[Array, "batch u v 3"], cloth: Float[Array, "batch 3"]
    ) -> Float[Array, " batch"]:
        mesh, seen = shown(mesh, voxels.observe(mesh, viewport=settings.net.viewport), settings.net)
        return meshes.error(most_probable(ordered(estimated(params, seen, cloth))).mean, mesh, cloth=cloth)

    longest = int(validation.length.max())
    long = [validation.length >= i for i in range(longest + 1)]
    by_step = [
        (jnp.asarray(validation.vertices[rows, i]), jnp.asarray(validation.cloth[rows])) for i, rows in enumerate(long)
    ]

    def validate(params: PyTree) -> dict[str, float]:
        errors = [float(errors_of(params, *examples).mean()) for examples in by_step]
        return {"score": float(np.mean(errors[1:])), **{f"step_{i}": error for i, error in enumerate(errors)}}

    def start(key: PRNGKeyArray) -> PyTree:
        return narrowed(initial(settings.net, settings.training.start, key=key), chosen)

    return Problem(start, gradient, validate)


def train_vtm(
    settings: TrainVtMConfig, training: Dataset, validation: Dataset, *, work: Path, key: PRNGKeyArray
) -> Trained:
    """Train VtM and return the weights with the best validation score.

    The score is the mean error over the states after 1 to 3 manipulations, as far as the validation split has them. An
    interrupted run resumes from the folder `work`.
    """
    data = states(training)
    chosen = taken(data, settings)
    trained = train(problem(settings, validation, chosen), data, settings.training, work=work, key=key)
    return dataclasses.replace(trained, params=widened(trained.params, chosen))


def example_units(
    net: Net, training: Dataset, settings: TrainVtMConfig, *, examples: int, seed: int
) -> Float[np.ndarray, "examples units"]:
    """The net's hidden units (`vtm.hidden_units`) for examples like those that it was trained on."""
    data = states(training)

    @jax.jit
    def units(key: PRNGKeyArray) -> Float[Array, "batch units"]:
        _, seen, cloth = drawn(data, settings, key=key)
        return hidden_units(net, seen, cloth)

    keys = jax.random.split(jax.random.key(seed), -(-examples // settings.training.batch))
    return np.concatenate([np.asarray(units(key)) for key in keys])[:examples]

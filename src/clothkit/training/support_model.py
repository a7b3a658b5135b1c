"""Training of the support model: recorded manipulations against random ones of the same states."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from clothkit.dataset.store import STEPS, Dataset
from clothkit.manipulation.draws import random_manipulations
from clothkit.models import support_model
from clothkit.models.forward import ForwardModel, rollout
from clothkit.models.support_model import SupportModel
from clothkit.training.settings import SupportTrainingConfig


def recorded_inputs(
    forward: ForwardModel, net: Any, dataset: Dataset
) -> tuple[Float[np.ndarray, "examples latent"], Float[np.ndarray, "examples 6"]]:
    """Return latents and recorded manipulations of all stretches of a dataset.

    Latents are those of true states, and those that the net predicts from earlier ones, as it does in a search.
    """

    @jax.jit
    def before(state: Array, manipulations: Array, cloth: Array) -> Array:
        first = forward.encode(net, state, cloth)
        found = rollout(forward, net, first, manipulations).latents
        return jnp.moveaxis(jnp.concatenate([first[None], found[:-1]]), 0, 1)

    latents, manipulations = [], []
    for start in range(STEPS):
        row = np.flatnonzero(dataset.length > start)
        own = np.nan_to_num(dataset.manipulation[row, start:])
        found = np.asarray(before(dataset.vertices[row, start], own, dataset.cloth[row]))
        kept = np.arange(start, STEPS)[None] < dataset.length[row, None]
        latents.append(found[kept])
        manipulations.append(own[kept])
    return np.concatenate(latents), np.concatenate(manipulations)


def train(forward: ForwardModel, net: Any, dataset: Dataset, settings: SupportTrainingConfig) -> SupportModel:
    """Train the support model of one forward net."""
    latents, manipulations = (jnp.asarray(part) for part in recorded_inputs(forward, net, dataset))
    shown = np.asarray(support_model.inputs(forward, latents, manipulations))
    key_initial, key_train = jax.random.split(jax.random.key(settings.seed))
    support = support_model.initial(settings.net, shown, key_initial)
    optimiser = optax.adamw(
        optax.cosine_decay_schedule(settings.learning_rate, settings.iterations), weight_decay=settings.decay
    )

    def loss(layers: Any, latent: Array, manipulation: Array, random: Array, noise: Array) -> Array:
        own = support._replace(layers=layers)
        logits = []
        for part in (manipulation, random):
            inputs = support_model.inputs(forward, latent, part)
            inputs = inputs.at[..., :-6].add(noise * own.std[:-6])
            logits.append(support_model.logit(own, inputs))
        return jnp.mean(jax.nn.softplus(-logits[0])) + jnp.mean(jax.nn.softplus(logits[1]))

    @jax.jit
    def step(carry: Any, key: PRNGKeyArray) -> tuple[Any, Array]:
        layers, state = carry
        key_row, key_swap, key_random, key_noise = jax.random.split(key, 4)
        row = jax.random.randint(key_row, (settings.batch,), 0, len(latents))
        manipulation = swapped(manipulations[row], key_swap)
        random = contrasted(manipulation, key_random)
        noise = settings.noise * jax.random.normal(key_noise, (settings.batch, shown.shape[1] - 6))
        value, gradient = jax.value_and_grad(loss)(layers, latents[row], manipulation, random, noise)
        update, state = optimiser.update(gradient, state, layers)
        return (optax.apply_updates(layers, update), state), value

    (layers, _), _ = jax.lax.scan(
        step, (support.layers, optimiser.init(support.layers)), jax.random.split(key_train, settings.iterations)
    )
    return support._replace(layers=jax.tree.map(np.asarray, layers))


def swapped(manipulation: Float[Array, "batch 6"], key: PRNGKeyArray) -> Float[Array, "batch 6"]:
    """Return manipulations whose grasp points are exchanged at random: which hand comes first means nothing."""
    exchanged = manipulation[:, jnp.array([2, 3, 0, 1, 4, 5])]
    return jnp.where(jax.random.bernoulli(key, shape=(len(manipulation), 1)), exchanged, manipulation)


KEPT_GRASPS, KEPT_DISPLACEMENT = 0.4, 0.1
"""Shares of the random manipulations that keep the recorded grasp points, or the recorded displacement."""


def contrasted(manipulation: Float[Array, "batch 6"], key: PRNGKeyArray) -> Float[Array, "batch 6"]:
    """Return random manipulations to tell recorded ones from; some keep a part of the recorded one."""
    key_random, key_kind = jax.random.split(key)
    random = random_manipulations((len(manipulation),), edge=0.7, key=key_random)
    kind = jax.random.uniform(key_kind, (len(manipulation), 1))
    grasps = jnp.where(kind < KEPT_GRASPS, manipulation[:, :4], random[:, :4])
    displacement = jnp.where(kind > 1 - KEPT_DISPLACEMENT, manipulation[:, 4:], random[:, 4:])
    return jnp.concatenate([grasps, displacement], axis=-1)

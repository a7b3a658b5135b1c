"""Optimisers: the paper's SignSGD, and Muon with AdamW (sections 4.6, 4.8; design 6.4)."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, PyTree
from optax.contrib import MuonDimensionNumbers, muon

from clothkit.training.settings import TrainingConfig


def sign_sum(shape: PyTree, position: PyTree) -> PyTree:
    """The gradients of both losses combined to sign(sign(g_s) + sign(g_p)) (section 4.6, design 6.4).

    Where the signs differ, the result is zero; where one gradient is zero (that of loss_p in D), the other decides.
    """
    return jax.tree.map(lambda s, p: jnp.sign(jnp.sign(s) + jnp.sign(p)), shape, position)


def direction(
    losses: Callable[[PyTree], tuple[Float[Array, ""], Float[Array, ""]]],
    params: PyTree,
    *,
    recipe: str,
    shift_weight: float,
) -> tuple[PyTree, dict[str, Float[Array, ""]]]:
    """The input of the optimiser for a forward model's two losses, and the losses by name.

    `losses` gives loss_s and loss_p for the weights. For the recipe `paper` the result is the sign sum of their
    separate gradients; for `fast` it is the gradient of loss_s + shift_weight loss_p, from one backward pass.
    """

    def both(params: PyTree) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
        loss_s, loss_p = losses(params)
        return loss_s + shift_weight * loss_p, {"loss_s": loss_s, "loss_p": loss_p}

    if recipe == "fast":
        return jax.grad(both, has_aux=True)(params)
    (loss_s, shape), (loss_p, position) = (
        jax.value_and_grad(lambda params, i=i: losses(params)[i])(params) for i in range(2)
    )
    return sign_sum(shape, position), {"loss_s": loss_s, "loss_p": loss_p}


def optimiser(training: TrainingConfig) -> optax.GradientTransformation:
    """The update rule of a recipe, including the learning rate schedule of `fast`.

    The halvings of `paper`'s rate are not included; the training loop applies them.
    """
    if training.recipe == "paper":
        return optax.sign_sgd(training.learning_rate)
    return muon(
        _schedule(training, training.muon_learning_rate),
        ns_steps=training.muon_iterations,
        # With AOL preconditioning, one iteration less gives updates as orthogonal (Boissin et al., "Turbo-Muon", 2025).
        preconditioning="aol" if training.muon_iterations < 5 else "frobenius",
        weight_decay=training.weight_decay,
        adam_weight_decay=training.weight_decay,
        adam_learning_rate=_schedule(training, training.learning_rate),
        muon_weight_dimension_numbers=lambda weights: jax.tree.map(lambda w: _muon_axes(w, training), weights),
    )


def _muon_axes(weight: Any, training: TrainingConfig) -> MuonDimensionNumbers | None:
    return MuonDimensionNumbers() if weight.ndim == 2 and max(weight.shape) <= training.muon_width else None


def _schedule(training: TrainingConfig, peak: float) -> optax.Schedule:
    rising = round(training.warm_up * training.iterations)
    return optax.warmup_cosine_decay_schedule(0.0 if rising else peak, peak, rising, training.iterations)


def rate(training: TrainingConfig, iteration: int) -> float:
    """The scheduled learning rate at an iteration, before any halving."""
    if training.recipe == "paper":
        return training.learning_rate
    return float(_schedule(training, training.learning_rate)(iteration))

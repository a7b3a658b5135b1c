"""The support model: how surprising a manipulation of a state is, compared with those that were recorded.

A small net tells recorded manipulations from random ones, given the state's latent (noise-contrastive estimation of a
density ratio: Gutmann and Hyvaerinen, AISTATS 2010). Its *surprise* is -log of the probability that the manipulation
was recorded. It works with a single forward net, too, and knows nothing of what a manipulation leads to.
"""

from itertools import chain, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from clothkit.models.canonical import Canonicalised
from clothkit.models.forward import ForwardModel
from clothkit.models.settings import SupportModelConfig
from clothkit.runtime.errors import InputError, system_error


class Layer(NamedTuple):
    """Weights of a dense layer."""

    weights: Float[Array, "inputs outputs"] | Float[np.ndarray, "inputs outputs"]
    bias: Float[Array, " outputs"] | Float[np.ndarray, " outputs"]


class SupportModel(NamedTuple):
    """The net's weights."""

    mean: Float[Array, " inputs"] | Float[np.ndarray, " inputs"]
    """Mean and standard deviation of the inputs over recorded manipulations."""
    std: Float[Array, " inputs"] | Float[np.ndarray, " inputs"]
    layers: tuple[Layer, ...]


def initial(
    settings: SupportModelConfig, inputs: Float[np.ndarray, "examples inputs"], key: PRNGKeyArray
) -> SupportModel:
    """Return initial weights (He et al., ICCV 2015) for inputs such as these."""
    widths = (inputs.shape[1], *settings.hidden, 1)
    layers = [
        Layer(jnp.sqrt(2 / a) * jax.random.normal(own, (a, b)), jnp.zeros(b))
        for a, b, own in zip(widths, widths[1:], jax.random.split(key, len(widths) - 1), strict=False)
    ]
    return SupportModel(inputs.mean(0), inputs.std(0) + LEAST_STD, tuple(layers))


LEAST_STD = 1e-3
"""Added to the standard deviations of inputs."""


def inputs(
    forward: ForwardModel,
    latent: Float[Array | np.ndarray, "*batch latent"],
    manipulation: Float[Array | np.ndarray, "*batch 6"],
) -> Float[Array, "*batch inputs"]:
    """Return what the net is shown: a latent and a manipulation as the forward model's M is shown them."""
    if isinstance(forward, Canonicalised):
        latent, manipulation = forward.shown(latent, manipulation)
    return jnp.concatenate([latent, manipulation], axis=-1)


def width_of(forward: ForwardModel, net: Any, state: Float[np.ndarray, "*state"]) -> int:
    """Return the number of inputs for a forward net, of which `state` is a state of the right shape."""
    found = jax.eval_shape(lambda net: inputs(forward, forward.encode(net, jnp.asarray(state)), jnp.zeros(6)), net)
    return int(found.shape[-1])


def logit(support: SupportModel, inputs: Float[Array, "*batch inputs"]) -> Float[Array, "*batch"]:
    """Return the logit of the probability that these are of a recorded manipulation."""
    units = (inputs - support.mean) / support.std
    for layer in support.layers[:-1]:
        units = jax.nn.silu(units @ layer.weights + layer.bias)
    return (units @ support.layers[-1].weights + support.layers[-1].bias)[..., 0]


def surprise(support: SupportModel, inputs: Float[Array, "*batch inputs"]) -> Float[Array, "*batch"]:
    """Return -log of the probability that these are of a recorded manipulation."""
    return jax.nn.softplus(-logit(support, inputs))


def save(path: Path, support: SupportModel) -> None:
    """Write a support model as NPZ. Equal models give equal bytes."""
    layers = {f"{name}_{i}": part for i, layer in enumerate(support.layers) for name, part in layer._asdict().items()}
    with path.open("wb") as file:
        np.savez(file, mean=support.mean, std=support.std, **layers)


def load(path: Path, *, width: int) -> SupportModel:
    """Read the support model of a net with inputs of that width. Raises InputError if it is damaged or of another."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            count = sum(name.startswith("weights") for name in arrays.files)
            layers = tuple(Layer(arrays[f"weights_{i}"], arrays[f"bias_{i}"]) for i in range(count))
            found = SupportModel(arrays["mean"], arrays["std"], layers)
    except OSError as error:
        raise system_error(error, path, expected="a support model") from error
    except Exception as error:  # NumPy raises many types of exceptions for damaged files
        raise InputError(f"{path}: expected a support model, found a truncated or damaged file") from error
    widths = [width, *(layer.bias.size for layer in found.layers)]
    fits = bool(found.layers) and found.mean.shape == found.std.shape == (width,) and widths[-1] == 1
    if not fits or any(layer.weights.shape != pair for layer, pair in zip(found.layers, pairwise(widths), strict=True)):
        raise InputError(f"{path}: expected a support model of a net with {width} inputs, found another; run dvc repro")
    if not all(np.isfinite(part).all() for part in (found.mean, found.std, *chain(*found.layers))):
        raise InputError(f"{path}: expected finite numbers, found NaN or infinity")
    return found

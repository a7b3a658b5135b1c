"""Forward models: E, M and D as pure functions of a net's weights, and their rollout (section 4.5, eqs. 2 to 5).

A net's configuration decides in `forward_model` which model its weights belong to, and whether that model is shown
canonical descriptions.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree, Shaped
from numpy import ndarray

from clothkit.cloth.mesh import Cloth
from clothkit.cloth.topology import PAPERS_CLOTH
from clothkit.models.canonical import MESHES, MESHES_OF_SQUARES, VOXELS, Canonicalised
from clothkit.models.emd_voxel import EMDVoxel
from clothkit.models.pemd import PEMD
from clothkit.models.settings import EMDVoxelConfig, PEMDConfig


@runtime_checkable
class ForwardModel(Protocol):
    """E, M and D as pure functions of a net's weights `params`, for states of shape `*state`.

    A state is a mesh [u v 3] or voxels [x y z], normalised and centred. A prediction is the output of D: a
    probabilistic mesh, or the logits of occupancy. Models are hashable, so that they can be static arguments of jit.
    """

    def encode(
        self, params: PyTree, state: Shaped[Array | ndarray, "*batch_and_state"], cloth: Cloth = PAPERS_CLOTH
    ) -> Float[Array, "*batch latent"]:
        """The latent of a state: eq. (2). `cloth` are the cloth's sides and thickness, for nets that are told them."""
        ...

    def step(
        self,
        params: PyTree,
        latent: Float[Array | ndarray, "*batch latent"],
        trace: Float[Array | ndarray, "*batch latent"],
        manipulation: Float[Array | ndarray, "*batch 6"],
    ) -> tuple[Float[Array, "*batch latent"], Float[Array, "*batch latent"], Float[Array, "*batch 2"]]:
        """Latent, memory trace and centre shift [normalised] after one manipulation: eq. (3).

        The first memory trace is zero.
        """
        ...

    def decode(self, params: PyTree, latent: Float[Array | ndarray, "*batch latent"], stride: int = 1) -> Any:
        """The prediction for a latent: eq. (4); of a mesh only the vertices that `topology.thinned` keeps."""
        ...


class Rollout(NamedTuple):
    """What M gives after each of n manipulations: eq. (5) without the decoder."""

    latents: Float[Array, "n *batch latent"]
    traces: Float[Array, "n *batch latent"]
    """Memory traces."""
    shifts: Float[Array, "n *batch 2"]
    """Displacements of the cloth's centre by each manipulation [normalised]."""


def forward_model(config: PEMDConfig | EMDVoxelConfig) -> ForwardModel:
    """The model that a net with this configuration was trained for."""
    if isinstance(config, PEMDConfig):
        of_meshes = PEMD(config)
        return Canonicalised(of_meshes, MESHES if config.told else MESHES_OF_SQUARES) if config.canonical else of_meshes
    of_voxels = EMDVoxel(config)
    return Canonicalised(of_voxels, VOXELS) if config.canonical else of_voxels


def rollout(
    model: ForwardModel,
    params: PyTree,
    latent: Float[Array, "*batch latent"],
    manipulations: Float[Array | ndarray, "*batch n 6"],
    trace: Float[Array | ndarray, "*batch latent"] | None = None,
    *,
    unroll: bool = False,
) -> Rollout:
    """Apply M once per manipulation: eq. (5) without the decoder. Without `trace` the first memory trace is zero.

    With `unroll` the program has the steps one after another instead of a loop, which takes longer to compile and less
    time to run.
    """

    def step(carry: tuple[Array, Array], manipulation: Array) -> tuple[tuple[Array, Array], Rollout]:
        latent, trace, shift = model.step(params, *carry, manipulation)
        return (latent, trace), Rollout(latent, trace, shift)

    first = jnp.zeros_like(latent) if trace is None else jnp.asarray(trace)
    steps = jnp.moveaxis(jnp.asarray(manipulations), -2, 0)
    return jax.lax.scan(step, (latent, first), steps, unroll=unroll)[1]


def predict(
    model: ForwardModel,
    params: PyTree,
    state: Shaped[Array | ndarray, "*batch_and_state"],
    manipulations: Float[Array | ndarray, "*batch n 6"],
    trace: Float[Array | ndarray, "*batch latent"] | None = None,
    *,
    cloth: Cloth = PAPERS_CLOTH,
    unroll: bool = False,
) -> tuple[Any, Rollout]:
    """Predictions [n *batch ..] of the state after each of n manipulations, and the rollout: eq. (5)."""
    found = rollout(model, params, model.encode(params, state, cloth), manipulations, trace, unroll=unroll)
    return model.decode(params, found.latents), found

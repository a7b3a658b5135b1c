"""pEM*D, the probabilistic forward model: encoder E, manipulator M, decoder D (section 4.5, design 6.3)."""

from dataclasses import dataclass

import flax.linen as nn
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree
from numpy import ndarray

from clothkit.cloth.mesh import Cloth, ProbabilisticMesh
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE, thinned
from clothkit.models.layers import dense, probabilistic_mesh, probabilistic_output, run, with_cloth
from clothkit.models.settings import PEMDConfig, Start

LAYERS = 16
"""Number of M's neuron layers: layer 0 is the input, layer 15 the output."""


class Encoder(nn.Module):
    """E, eq. (2): hidden layers with tanh, linear output."""

    config: PEMDConfig

    @nn.compact
    def __call__(self, mesh: Float[Array, "*batch u v 3"], cloth: Cloth) -> Float[Array, "*batch latent"]:
        units = mesh.reshape(*mesh.shape[:-3], -1)
        if self.config.told:
            units = with_cloth(units, cloth)
        for i, width in enumerate(self.config.encoder):
            units = jnp.tanh(dense(width, f"layer_{i + 1}")(units))
        return dense(self.config.latent, "latent")(units)


class Manipulator(nn.Module):
    """M, eq. (3): 16 layers with a residual channel, which is the first `latent` units of every layer.

    Every layer is dense; its input is the layer before it, with the manipulation appended. After tanh, the channel of
    the layer before is added to that of the new layer. Layers 2, 4, .., 12 are also projected into the channel of
    layers 4, .., 14, before the tanh. The centre shift is an output without tanh.
    """

    latent: int
    """Units of the latent, of the memory trace and of the residual channel."""
    width: int
    """Units of the hidden layers, without the manipulation."""
    start: Start

    @nn.compact
    def __call__(
        self,
        latent: Float[Array, "*batch latent"],
        trace: Float[Array, "*batch latent"],
        manipulation: Float[Array, "*batch 6"],
    ) -> tuple[Float[Array, "*batch latent"], Float[Array, "*batch latent"], Float[Array, "*batch 2"]]:
        channel = self.latent
        layers = [jnp.concatenate([latent, trace, manipulation], axis=-1)]
        for i in range(1, LAYERS - 1):
            units = self._writing(self.width, f"layer_{i}")(layers[-1])
            if i >= 4 and i % 2 == 0:
                skip = dense(channel, f"skip_{i - 2}_{i}", scale=self.start.residual, bias=False)(layers[i - 2])
                units = units + self._widened(skip)
            units = jnp.tanh(units) + self._widened(layers[-1][..., :channel])
            layers.append(jnp.concatenate([units, manipulation], axis=-1))
        output = self._writing(2 * channel + 2, f"layer_{LAYERS - 1}")(layers[-1])
        new_latent = jnp.tanh(output[..., :channel]) + layers[-1][..., :channel]
        return new_latent, jnp.tanh(output[..., channel : 2 * channel]), output[..., 2 * channel :]

    def _widened(self, channel: Float[Array, "*batch latent"]) -> Float[Array, "*batch width"]:
        """The channel, padded with zeros to the width of a hidden layer.

        XLA fuses the padding with other operations, which it does not do with an indexed update.
        """
        wider = [(0, 0)] * (channel.ndim - 1) + [(0, self.width - self.latent)]
        return jnp.pad(channel, wider)

    def _writing(self, width: int, name: str) -> nn.Dense:
        """A dense layer whose first `latent` outputs belong to the residual channel.

        The initial weights of these outputs are scaled by `start.residual`.
        """
        channel, factor = self.latent, self.start.residual
        glorot = nn.initializers.glorot_uniform()

        def weights(key: Array, shape: tuple[int, int], dtype: type) -> Array:
            return glorot(key, shape, dtype) * jnp.where(jnp.arange(shape[1]) < channel, factor, 1.0).astype(dtype)

        return nn.Dense(width, kernel_init=weights, name=name)


class Decoder(nn.Module):
    """D, eq. (4): hidden layers with tanh, and the output of eq. (6)."""

    config: PEMDConfig
    start: Start

    @nn.compact
    def __call__(self, latent: Float[Array, "*batch latent"]) -> ProbabilisticMesh:
        # Batch axes are merged into one, because with two of them the backward pass took twice as long on CPUs.
        units = latent.reshape(-1, latent.shape[-1])
        for i, width in enumerate(self.config.decoder):
            units = jnp.tanh(dense(width, f"layer_{i + 1}")(units))
        units = probabilistic_output("mesh", self.start)(units)
        return probabilistic_mesh(units.reshape(*latent.shape[:-1], -1), self.config.least_std)


class PEMDModule(nn.Module):
    """E, M and D in one module; `start` affects the initial weights only."""

    config: PEMDConfig
    start: Start = Start()

    def setup(self) -> None:
        self.E = Encoder(self.config)
        self.M = Manipulator(self.config.latent, self.config.manipulation, self.start)
        self.D = Decoder(self.config, self.start)

    def __call__(self, mesh: Float[Array, "*batch u v 3"], manipulation: Float[Array, "*batch 6"]) -> ProbabilisticMesh:
        latent = self.E(mesh, jnp.asarray(PAPERS_CLOTH))
        return self.D(self.M(latent, jnp.zeros_like(latent), manipulation)[0])

    def encode(self, mesh: Float[Array, "*batch u v 3"], cloth: Cloth) -> Float[Array, "*batch latent"]:
        return self.E(mesh, cloth)

    def step(
        self,
        latent: Float[Array, "*batch latent"],
        trace: Float[Array, "*batch latent"],
        manipulation: Float[Array, "*batch 6"],
    ) -> tuple[Float[Array, "*batch latent"], Float[Array, "*batch latent"], Float[Array, "*batch 2"]]:
        return self.M(latent, trace, manipulation)

    def decode(self, latent: Float[Array, "*batch latent"]) -> ProbabilisticMesh:
        return self.D(latent)


def initial(config: PEMDConfig, start: Start = Start(), *, key: PRNGKeyArray) -> PyTree:  # noqa: B008
    """Initial weights for training."""
    return PEMDModule(config, start).init(key, jnp.zeros((*SQUARE.shape, 3)), jnp.zeros(6))["params"]


@dataclass(frozen=True)
class PEMD:
    """pEM*D as a `ForwardModel`: states are meshes, predictions probabilistic meshes [normalised]."""

    config: PEMDConfig

    def encode(
        self, params: PyTree, state: Float[Array | ndarray, "*batch u v 3"], cloth: Cloth = PAPERS_CLOTH
    ) -> Float[Array, "*batch latent"]:
        """The latent of a centred mesh [normalised]: eq. (2)."""
        return run(PEMDModule(self.config), params, jnp.asarray(state), jnp.asarray(cloth), method="encode")

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
        latent, trace, manipulation = map(jnp.asarray, (latent, trace, manipulation))
        return run(PEMDModule(self.config), params, latent, trace, manipulation, method="step")

    def decode(
        self, params: PyTree, latent: Float[Array | ndarray, "*batch latent"], stride: int = 1
    ) -> ProbabilisticMesh:
        """The probabilistic mesh [normalised] for a latent: eq. (4).

        With a stride above 1, only the vertices that `topology.thinned` keeps are computed and returned.
        """
        latent = jnp.asarray(latent)
        if stride == 1:
            return run(PEMDModule(self.config), params, latent, method="decode")
        return self._decode_thinned(params["D"], latent, stride)

    def _decode_thinned(self, decoder: PyTree, latent: Float[Array, "*batch latent"], stride: int) -> ProbabilisticMesh:
        """D with an output layer for some of the vertices only.

        This saves time because most of a search's arithmetic is in the output layer, while neighbouring vertices have
        similar predictions.
        """
        units = latent.reshape(-1, latent.shape[-1])
        for i in range(len(self.config.decoder)):
            layer = decoder[f"layer_{i + 1}"]
            units = jnp.tanh(units @ layer["kernel"] + layer["bias"])
        kernel, bias = (
            thinned(decoder["mesh"][name].reshape(-1, *SQUARE.shape, 6), stride) for name in ("kernel", "bias")
        )
        units = units @ kernel.reshape(len(kernel), -1) + bias.reshape(-1)
        units = units.reshape(*latent.shape[:-1], *kernel.shape[1:])
        return ProbabilisticMesh(units[..., :3], jnp.exp(units[..., 3:]) + self.config.least_std)

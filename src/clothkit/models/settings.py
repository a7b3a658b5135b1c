"""Settings of the nets: widths, input forms and initial weights; the defaults are the paper's (table 1)."""

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Lt, MinLen

from clothkit.cloth.voxels import VIEWPORT, Viewport
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]
Rate = Annotated[float, Gt(0)]


@config
class PEMDConfig:
    """Widths of pEM*D."""

    latent: Count = 512
    """Units of the latent, of the memory trace and of M's residual channel."""
    encoder: Annotated[tuple[Count, ...], MinLen(1)] = (2048, 1024)
    manipulation: Count = 1024
    """Units of M's hidden layers, without the manipulation that is appended to each; at least `latent`."""
    decoder: Annotated[tuple[Count, ...], MinLen(1)] = (1024, 2048)
    least_std: Rate = 0.01
    """Constant that eq. (6) adds to every standard deviation [normalised]: a lower bound of predicted uncertainty."""
    canonical: bool = False
    """Whether inputs are transformed to canonical descriptions (canonical.py); the paper's net does not do this."""
    told: bool = False
    """Whether the net is told the cloth's sides and thickness, as the paper's net, which knows one cloth, is not."""

    def __post_init__(self) -> None:
        if self.manipulation < self.latent:
            raise ValueError(f"manipulation must be at least latent ({self.latent})")


@config
class VtMConfig:
    """Width of VtM, and the form of its inputs."""

    hidden: Count = 4096
    views: Literal[1, 8] = 1
    """With 8, an estimate combines those from all versions of the voxels rotated by right angles and mirrored."""
    hypotheses: Count = 1
    """Number of shapes among which the net may be undecided (hypotheses.py); the paper's net has one answer."""
    least_std: Rate = 0.01
    """Constant that eq. (6) adds to every standard deviation [normalised]."""
    sigma_factor: Rate = 1.0
    """The net's standard deviations sigma are mapped to sigma_factor x sigma ** sigma_power (recalibration.py)."""
    sigma_power: Rate = 1.0
    canonical: bool = False
    """Whether input voxels are turned to be widest along x (canonical.py); only four of the eight views then differ."""
    viewport: Viewport = VIEWPORT
    """Of the input voxels."""
    told: bool = False
    """Whether the net is told the cloth's sides and thickness, as the paper's net, which knows one cloth, is not."""


@config
class EMDVoxelConfig:
    """Widths of the voxel EM*D."""

    latent: Count = 512
    """Units of the latent, of the memory trace and of M's residual channel; also E's last number of feature maps."""
    manipulation: Count = 1024
    """Units of M's hidden layers, without the manipulation that is appended to each; at least `latent`."""
    width: Rate = 1.0
    """Factor on the numbers of feature maps of E's and D's layers, 32, 32, 64, 128 and 256; rounded, at least 1."""
    dense: bool = False
    """Whether E and D are fully connected, as in the mesh version, instead of convolutional."""
    canonical: bool = False
    """Whether input voxels are rotated by right angles and mirrored to a canonical description (canonical.py)."""
    encoder: Annotated[tuple[Count, ...], MinLen(1)] = (2048, 1024)
    """Widths of E's hidden layers; `dense` only."""
    decoder: Annotated[tuple[Count, ...], MinLen(1)] = (1024, 2048)
    """Widths of D's hidden layers; `dense` only."""

    def __post_init__(self) -> None:
        if self.manipulation < self.latent:
            raise ValueError(f"manipulation must be at least latent ({self.latent})")


@config
class EnsembleConfig:
    """The members of an ensemble of forward models."""

    members: Annotated[tuple[Annotated[int, Ge(0), Lt(2**32)], ...], MinLen(1)] = (0, 1)
    """Numbers of the members: each number selects the random key that a net is trained from."""

    def __post_init__(self) -> None:
        if len(set(self.members)) != len(self.members):
            raise ValueError("members must differ from one another")


@config
class Start:
    """Initial weights. The defaults are Glorot weights and zero biases (design 6.3)."""

    residual: Rate = 1.0
    """Factor on the initial weights whose outputs belong to M's residual channel."""
    output: Rate = 1.0
    """Factor on the initial weights of the output layer."""
    sigma: float = 0.0
    """Initial bias of the output units for sigma: standard deviations start near exp(sigma) + least_std."""
    logit: float = 0.0
    """Initial bias of the output units for voxels: probabilities of occupancy start near the sigmoid of it."""


@config
class SupportModelConfig:
    """Sizes of the support model."""

    hidden: Annotated[tuple[Count, ...], MinLen(1)] = (256, 256)
    """Widths of the hidden layers."""

"""Settings of the nets and their training; the defaults are the paper's (table 1, sections 4.6 to 4.8)."""

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, MinLen

from clothkit.cloth.voxels import HEIGHT
from clothkit.config import config

Count = Annotated[int, Gt(0)]
Rate = Annotated[float, Gt(0)]
Share = Annotated[float, Ge(0), Le(1)]
NotNegative = Annotated[float, Ge(0)]


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
    """What eq. (6) adds to every standard deviation [normalised]: errors below it can't be told to be so small."""
    canonical: bool = False
    """Whether the net sees every cloth in one of its many descriptions (canonical.py); the paper's does not."""

    def __post_init__(self) -> None:
        if self.manipulation < self.latent:
            raise ValueError(f"manipulation must be at least latent ({self.latent})")


@config
class VtMConfig:
    """Width of VtM, and how it is asked."""

    hidden: Count = 4096
    views: Literal[1, 8] = 1
    """Estimates are averaged over so many views of the voxels: as they are, or turned and mirrored, too."""
    least_std: Rate = 0.01
    """As for the forward models."""
    canonical: bool = False
    """Whether the net sees all voxels lying widest along x (canonical.py); four views of eight are left then."""
    height: Rate = HEIGHT
    """Upper end of the voxels that it sees [normalised]."""


@config
class EMDVoxelConfig:
    """Widths of the voxel EM*D."""

    latent: Count = 512
    """Units of the latent, of the memory trace and of M's residual channel; E's last layer gives as many maps."""
    manipulation: Count = 1024
    """Units of M's hidden layers, without the manipulation that is appended to each; at least `latent`."""
    width: Rate = 1.0
    """Factor on the feature maps of E's and D's layers, 32, 32, 64, 128 and 256; rounded, at least one each."""
    dense: bool = False
    """Fully connected E and D, as in the mesh version, in place of convolutions."""
    canonical: bool = False
    """Whether the net sees all voxels in one of the eight descriptions that right angles and mirrors make."""
    encoder: Annotated[tuple[Count, ...], MinLen(1)] = (2048, 1024)
    """`dense` only."""
    decoder: Annotated[tuple[Count, ...], MinLen(1)] = (1024, 2048)
    """`dense` only."""

    def __post_init__(self) -> None:
        if self.manipulation < self.latent:
            raise ValueError(f"manipulation must be at least latent ({self.latent})")


@config
class Start:
    """Where training starts from: Glorot weights, zero biases (design 6.3), unless told otherwise."""

    residual: Rate = 1.0
    """Factor on the Glorot scale of the weights that write into the residual channel."""
    output: Rate = 1.0
    """Factor on the Glorot scale of the last layer's weights."""
    sigma: float = 0.0
    """Bias of the units that give sigma: std starts near exp(sigma) + least_std [normalised]."""
    logit: float = 0.0
    """Bias of the units that give voxels: they start near the sigmoid of it."""


@config
class TrainingConfig:
    """One training run."""

    seed: Annotated[int, Ge(0)] = 0
    recipe: Literal["paper", "fast"] = "paper"
    """`paper`: SignSGD, halved when validation stalls. `fast`: Muon and AdamW, warm-up and cosine."""
    iterations: Count = 1_600_000
    batch: Count = 64
    learning_rate: Rate = 5e-5
    """Of SignSGD (`paper`), or at the peak of AdamW's schedule (`fast`)."""
    muon_learning_rate: Rate = 7e-3
    """At the peak of Muon's schedule; `fast` only."""
    muon_width: Annotated[int, Ge(0)] = 1100
    """Muon takes the matrices that are at most this wide on both sides, AdamW the rest; `fast` only."""
    muon_iterations: Count = 5
    """Newton-Schulz iterations by which Muon makes an update orthogonal; `fast` only."""
    weight_decay: NotNegative = 0.0
    """Of all weights, times the rate; `fast` only."""
    warm_up: Share = 0.05
    """Share of the iterations in which the rates rise; then they fall as a cosine to zero; `fast` only."""
    validate_every: Count = 10_000
    """Iterations between validation scores; also how often a resumable checkpoint is kept."""
    patience: Count = 5
    """Validations without improvement before the learning rate is halved; `paper` only."""
    stop_below: NotNegative = 0.0
    """Training ends once the learning rate is below this; `paper` only."""
    precision: Literal["default", "float32", "tensorfloat32", "bfloat16"] = "default"
    """Of matrix products in training, on devices that have the choice; a CPU takes float32 whatever is asked for."""
    steps_per_call: Count = 50
    """Iterations that run on the device without a word to the host."""
    start: Start = Start()


@config
class TrainPEMDConfig:
    """One forward model and its training."""

    net: PEMDConfig = PEMDConfig()
    training: TrainingConfig = TrainingConfig()
    noise: NotNegative = 0.025
    """Standard deviation of the noise on the input's vertices [normalised]."""
    shift_weight: NotNegative = 1.0
    """Weight of loss_p beside loss_s; `recipe: fast` only, the paper's needs none."""
    hold: Share = 0.0
    """How far uncertain vertices are held in the likelihood, 0 to 1 (likelihood.py); `recipe: fast` only."""


@config
class TrainVtMConfig:
    """VtM and its training."""

    net: VtMConfig = VtMConfig()
    training: TrainingConfig = TrainingConfig(stop_below=1e-7)
    noise: NotNegative = 0.025
    """Standard deviation of the noise on the input's points, in x and y [normalised]; 0 needs no duplicates."""
    noise_z_factor: NotNegative = 1.0
    """The noise in z, as a multiple of that in x and y (design 6.14)."""
    hold: Share = 0.0
    """As for the forward models; whatever the recipe."""
    flat: Share = 0.05
    """Share of flat cloths among the examples: every sequence starts with the same one."""
    rare: Share = 0.0
    """Voxels that are occupied in no more than this share of the examples are left out: their weights are zero."""


@config
class TrainEMDVoxelConfig:
    """One forward model of the voxel baseline and its training."""

    net: EMDVoxelConfig = EMDVoxelConfig()
    training: TrainingConfig = TrainingConfig()
    noise: NotNegative = 0.025
    """Standard deviation of the noise on the input's points, in x and y [normalised]; 0 needs no duplicates."""
    noise_z_factor: NotNegative = 1.0
    """The noise in z, as a multiple of that in x and y (design 6.14)."""
    shift_weight: NotNegative = 1.0
    """Weight of loss_p beside loss_s; `recipe: fast` only, the paper's needs none."""

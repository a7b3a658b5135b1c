"""Settings of training; the defaults are the paper's (sections 4.6 to 4.8)."""

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from clothkit.models.settings import EMDVoxelConfig, PEMDConfig, Start, SupportModelConfig, VtMConfig
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]
Rate = Annotated[float, Gt(0)]
Share = Annotated[float, Ge(0), Le(1)]
NotNegative = Annotated[float, Ge(0)]


@config
class TrainingConfig:
    """Settings of one training run."""

    seed: Annotated[int, Ge(0)] = 0
    recipe: Literal["paper", "fast"] = "paper"
    """`paper`: SignSGD, halved when validation stalls. `fast`: Muon and AdamW, warm-up and cosine."""
    iterations: Count = 1_600_000
    batch: Count = 64
    learning_rate: Rate = 5e-5
    """Initial rate of SignSGD (`paper`), or peak rate of AdamW's schedule (`fast`)."""
    muon_learning_rate: Rate = 7e-3
    """Peak rate of Muon's schedule; `fast` only."""
    muon_width: Annotated[int, Ge(0)] = 1100
    """Muon updates the weight matrices with at most this many rows and columns, AdamW the rest; `fast` only."""
    muon_iterations: Count = 5
    """Newton-Schulz iterations with which Muon orthogonalises an update; `fast` only."""
    weight_decay: NotNegative = 0.0
    """Weight decay of all weights, multiplied by the learning rate; `fast` only."""
    warm_up: Share = 0.05
    """Share of the iterations in which the rates rise linearly, before a cosine decay to zero; `fast` only."""
    validate_every: Count = 10_000
    """Iterations between validations; a checkpoint is written after each validation."""
    patience: Count = 5
    """Validations without improvement after which the learning rate is halved; `paper` only."""
    stop_below: NotNegative = 0.0
    """Training ends when the learning rate is below this value; `paper` only."""
    precision: Literal["default", "float32", "tensorfloat32", "bfloat16"] = "default"
    """Precision of matrix products in training, on devices that support it; CPUs always use float32."""
    steps_per_call: Count = 50
    """Iterations per call of the compiled training function, from which the host gets the mean losses."""
    start: Start = Start()


@config
class TrainPEMDConfig:
    """Settings of one pEM*D net and its training."""

    net: PEMDConfig = PEMDConfig()
    training: TrainingConfig = TrainingConfig()
    noise: NotNegative = 0.025
    """Standard deviation of the noise on the input's vertices [normalised]."""
    shift_weight: NotNegative = 1.0
    """Weight of loss_p relative to loss_s; `recipe: fast` only."""
    hold: Share = 0.0
    """Extra weight of uncertain coordinates in the likelihood, 0 (none) to 1 (likelihood.py); `recipe: fast` only."""


@config
class CameraNoise:
    """What a depth camera does to the points from which VtM's training inputs are made; each example draws its own."""

    noise: NotNegative = 0.005
    """Standard deviation of each point in x, y and z [normalised]."""
    bias: NotNegative = 0.004
    """Standard deviation of the height of all points of an example [normalised]: the table's plane is found, too."""
    tilt: NotNegative = 0.01
    """Standard deviation of the slope of the table along x and along y [rad], by which its plane is found askew."""
    step: NotNegative = 0.007
    """Largest step in which heights are told [normalised]: 2 mm for a cloth of 0.4 m, as of depth in millimetres seen
    from 0.8 m. Each example draws its own, from 0 on, and where the steps begin."""
    holes: Annotated[int, Ge(0), Le(16)] = 3
    """Largest number of round holes."""
    radius: NotNegative = 0.12
    """Largest radius of a hole [normalised]."""
    missing: Share = 0.3
    """Largest share of points that are missing one by one."""
    shift: NotNegative = 0.02
    """Standard deviation in x and y of the centre that is observed [normalised]; the mesh is learnt from there, too."""


@config
class TrainVtMConfig:
    """Settings of VtM and its training."""

    net: VtMConfig = VtMConfig()
    training: TrainingConfig = TrainingConfig(stop_below=1e-7)
    noise: NotNegative = 0.025
    """Standard deviation of the noise on the input's points in x and y [normalised]; 0 also omits the duplication."""
    noise_z_factor: NotNegative = 1.0
    """The noise in z as a multiple of that in x and y (design 6.14)."""
    camera: CameraNoise | None = None
    """A depth camera's noise, in place of that of `noise`."""
    hold: Share = 0.0
    """Extra weight of uncertain coordinates in the likelihood, 0 (none) to 1 (likelihood.py); for both recipes."""
    flat: Share = 0.05
    """Share of flat cloths among the training examples; the others are states that follow a manipulation."""
    recalibrate: bool = False
    """Whether the net's standard deviations are made true on the validation split after training."""
    rare: Share = 0.0
    """Voxels that are occupied in at most this share of the examples are not used as inputs: their weights are zero."""


@config
class TrainEMDVoxelConfig:
    """Settings of one voxel EM*D net and its training."""

    net: EMDVoxelConfig = EMDVoxelConfig()
    training: TrainingConfig = TrainingConfig()
    noise: NotNegative = 0.025
    """Standard deviation of the noise on the input's points in x and y [normalised]; 0 also omits the duplication."""
    noise_z_factor: NotNegative = 1.0
    """The noise in z as a multiple of that in x and y (design 6.14)."""
    shift_weight: NotNegative = 1.0
    """Weight of loss_p relative to loss_s; `recipe: fast` only."""


@config
class SupportTrainingConfig:
    """Settings of the support model and its training."""

    net: SupportModelConfig = SupportModelConfig()
    iterations: Count = 2000
    batch: Count = 512
    learning_rate: Rate = 0.001
    decay: NotNegative = 0.03
    """Weight decay of AdamW."""
    noise: NotNegative = 0.05
    """Standard deviation of noise on the latents, in standard deviations."""
    seed: Annotated[int, Ge(0)] = 0

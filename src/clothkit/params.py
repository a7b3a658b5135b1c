"""params.yaml, typed and validated: one frozen model per stage. Read by stage scripts and the app alone."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from annotated_types import Ge, Gt
from ruamel.yaml import YAML, YAMLError

from clothkit.app.settings import AppConfig
from clothkit.dataset.augment import AugmentConfig
from clothkit.dataset.regularise import RegulariseConfig
from clothkit.errors import InputError
from clothkit.evaluation.camera_settings import EvaluateCameraConfig
from clothkit.evaluation.settings import EvaluateEstimationConfig, EvaluatePlanningConfig, EvaluatePredictionConfig
from clothkit.networks.settings import TrainEMDVoxelConfig, TrainPEMDConfig, TrainVtMConfig
from clothkit.planning.settings import NormaliseConfig, PlanConfig
from clothkit.report.card.settings import CardConfig
from clothkit.report.settings import ReportConfig
from clothkit.simulation.settings import SimulateConfig

Scale = Literal["smoke", "laptop", "overnight", "paper"]


class StageParams(pydantic.BaseModel, frozen=True, extra="forbid"):
    """The settings of every stage at one scale."""

    simulate: SimulateConfig
    card: CardConfig
    regularise: RegulariseConfig
    augment: AugmentConfig
    train_pemd: TrainPEMDConfig
    train_emd_voxel: TrainEMDVoxelConfig
    train_vtm: TrainVtMConfig
    normalise: NormaliseConfig
    evaluate_estimation: EvaluateEstimationConfig
    evaluate_prediction: EvaluatePredictionConfig
    plan: PlanConfig
    evaluate_camera: EvaluateCameraConfig
    evaluate_planning: EvaluatePlanningConfig
    report: ReportConfig


class Params(pydantic.BaseModel, frozen=True, extra="forbid"):
    """The whole file: the scale in force, the planning weights of eqs. (13) and (15), the command line's settings, and
    every scale's."""

    scale: Scale
    alpha: Annotated[float, Ge(0)]
    beta: Annotated[float, Gt(0)]
    gamma: float
    app: AppConfig = AppConfig()
    scales: dict[Scale, StageParams]

    @property
    def stages(self) -> StageParams:
        """The settings of the scale in force."""
        return self.scales[self.scale]

    def section(self, stage: str) -> dict[str, Any]:
        """One stage's settings as JSON types, defaults filled in."""
        return pydantic.TypeAdapter(StageParams).dump_python(self.stages, mode="json")[stage]


def load_params(path: Path) -> Params:
    """Read and check a params file. Raises InputError naming the first key that is unknown, mistyped or impossible."""
    try:
        raw = YAML(typ="safe").load(path)
    except FileNotFoundError as error:
        raise InputError(f"{path}: not found; run from the repository's root") from error
    except YAMLError as error:
        raise InputError(f"{path}: is not valid YAML ({' '.join(str(error).split())})") from error
    try:
        params = Params.model_validate_json(json.dumps(raw), strict=True)
    except pydantic.ValidationError as error:
        raise InputError(f"{path}: {_sentence(error.errors()[0])}") from error
    if params.scale not in params.scales:
        raise InputError(f"{path}: scale is {params.scale!r}, but scales has no such block")
    return params


def _sentence(error: Any) -> str:
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{key} is not a known key"
    if error["type"] == "missing":
        return f"{key} is missing"
    message = error["msg"][0].lower() + error["msg"][1:]
    return f"{key}: {message}, found {error['input']!r}"

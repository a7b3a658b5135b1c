"""params.yaml, typed and validated: one frozen model per stage. Only stage scripts and the app read it."""

import datetime
import json
import math
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from annotated_types import Ge, Gt
from ruamel.yaml import YAML, YAMLError
from ruamel.yaml.constructor import ConstructorError, SafeConstructor
from ruamel.yaml.error import MarkedYAMLError, ReusedAnchorWarning

from clothkit.app.settings import AppConfig
from clothkit.dataset.augment import AugmentConfig
from clothkit.dataset.regularise import RegulariseConfig
from clothkit.evaluation.camera_settings import EvaluateCameraConfig, SetAlarmsConfig
from clothkit.evaluation.settings import (
    CalibrateConfig,
    EvaluateEstimationConfig,
    EvaluatePlanningConfig,
    EvaluatePredictionConfig,
    ProbeConfig,
)
from clothkit.goals.settings import EvaluateGoalsConfig
from clothkit.models.settings import EnsembleConfig
from clothkit.planning.settings import NormaliseConfig, PlanConfig
from clothkit.planning.systems import SYSTEMS
from clothkit.prebuilt.settings import PrebuildConfig
from clothkit.report.card.settings import CardConfig
from clothkit.report.settings import ReportConfig
from clothkit.runtime.errors import InputError, system_error
from clothkit.simulation.settings import INDIFFERENT, SimulateConfig
from clothkit.training.settings import SupportTrainingConfig, TrainEMDVoxelConfig, TrainPEMDConfig, TrainVtMConfig

Scale = Literal["smoke", "laptop", "overnight", "paper", "household"]


class StageParams(pydantic.BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The settings of every stage at one scale."""

    simulate: SimulateConfig
    card: CardConfig
    regularise: RegulariseConfig
    augment: AugmentConfig
    train_pemd: TrainPEMDConfig
    train_emd_voxel: TrainEMDVoxelConfig | None  # null: no voxel baseline at this scale
    train_vtm: TrainVtMConfig
    set_alarms: SetAlarmsConfig
    train_support: SupportTrainingConfig
    normalise: NormaliseConfig
    probe: ProbeConfig
    calibrate: CalibrateConfig
    evaluate_estimation: EvaluateEstimationConfig
    evaluate_prediction: EvaluatePredictionConfig
    plan: PlanConfig
    evaluate_camera: EvaluateCameraConfig
    evaluate_goals: EvaluateGoalsConfig | None  # null: no named goals at this scale
    evaluate_planning: EvaluatePlanningConfig
    prebuild: PrebuildConfig | None  # null: no prebuilt nets at this scale
    report: ReportConfig

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "StageParams":
        lists = {"plan.systems": self.plan.systems, "evaluate_planning.systems": self.evaluate_planning.systems}
        lists["report.planners"] = self.report.planners
        for (whole, some), (part, chosen) in pairwise(lists.items()):
            if missing := [system for system in chosen if system not in some]:
                raise ValueError(f"{part} has {missing[0]}, which {whole} leaves out")
        voxels = [system for system in self.plan.systems if SYSTEMS[system].voxels]
        if self.train_emd_voxel is None and voxels:
            raise ValueError(f"plan.systems has {voxels[0]}, which plans in voxels, but train_emd_voxel is null")
        if self.evaluate_goals is None and self.report.goals:
            raise ValueError("report.goals is true, but evaluate_goals is null")
        highest, seen = self.simulate.limits.height, self.train_vtm.net.viewport.height
        if seen < highest:
            raise ValueError(
                f"train_vtm.net.viewport.height is {seen:g}, but simulate.limits.height lets states be {highest:g} high"
            )
        return self


class Params(pydantic.BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The whole file: the selected scale, the planning weights of eqs. (13) and (15), the members of the ensemble, the
    command line's settings, and the stages' settings at every scale."""

    scale: Scale
    alpha: Annotated[float, Ge(0)]
    beta: Annotated[float, Gt(0)]
    gamma: float
    app: AppConfig = AppConfig()
    ensemble: EnsembleConfig = EnsembleConfig()
    scales: dict[Scale, StageParams]

    @property
    def stages(self) -> StageParams:
        """The stages' settings at the selected scale."""
        return self.scales[self.scale]

    def section(self, stage: str) -> dict[str, Any]:
        """One stage's settings as JSON types, with defaults filled in."""
        return pydantic.TypeAdapter(StageParams).dump_python(self.stages, mode="json")[stage]

    def decisive_section(self, stage: str) -> dict[str, Any]:
        """The same without settings that change no outcome: what results are told to depend on."""
        left_out = INDIFFERENT if stage == "simulate" else ()
        return {name: value for name, value in self.section(stage).items() if name not in left_out}


def load_params(path: Path) -> Params:
    """Read and check a params file. Raises InputError naming the first key that is unknown, mistyped or impossible."""
    raw = _read(path)
    if not isinstance(raw, dict):
        found = "nothing" if raw is None else f"a {_KINDS.get(type(raw), 'single value')}"
        raise InputError(f"{path}: expected keys (scale, alpha, ..) with their values, found {found}")
    try:
        _check_plain(raw, (), [0])
        params = Params.model_validate_json(json.dumps(raw), strict=True)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except pydantic.ValidationError as error:
        raise InputError(f"{path}: {_sentence(error.errors()[0])}") from error
    if params.scale not in params.scales:
        raise InputError(f"{path}: scale is {params.scale!r}, but scales has no such block")
    return params


class _Constructor(SafeConstructor):
    """YAML's safe constructor, which reports the line of an invalid value (month 13, an integer of 5,000 digits)."""

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, KeyError) as error:
            kind = str(node.tag).rsplit(":", 1)[-1]
            raise ConstructorError(None, None, f"this can't be taken as {kind}", node.start_mark) from error


def _read(path: Path) -> Any:
    yaml = YAML(typ="safe", pure=True)
    yaml.Constructor = _Constructor
    try:
        text = path.read_text(encoding="utf-8")
        with warnings.catch_warnings(action="ignore", category=ReusedAnchorWarning):
            return yaml.load(text)
    except FileNotFoundError as error:
        raise InputError(f"{path}: not found; run from the repository's root") from error
    except OSError as error:
        raise system_error(error, path) from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text (from byte {error.start} on)") from error
    except RecursionError as error:
        raise InputError(f"{path}: expected at most {_DEEPEST} levels of nesting, found far more") from error
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = text.splitlines()[mark.line : mark.line + 1]
        place = f"line {mark.line + 1}, {_short(line[0].strip() if line else '')}"
        raise InputError(f"{path}: is not valid YAML ({place}: {' '.join(str(error.problem).split())})") from error
    except YAMLError as error:
        raise InputError(f"{path}: is not valid YAML ({' '.join(str(error).split())})") from error


_KINDS = {
    list: "list",
    tuple: "pair",
    set: "set",
    bytes: "piece of binary data",
    datetime.date: "date",
    datetime.datetime: "date",
}
_MOST_VALUES, _DEEPEST = 100_000, 50


def _check_plain(value: Any, key: tuple[str, ...], count: list[int]) -> None:
    """Refuse values that JSON can't hold; `json.dumps` would convert them silently, or fail without naming the key.

    Also refuses too many values and too deep nesting. `key` is the path to the value, and `count` holds the number of
    values checked so far. Raises InputError that names the key.
    """
    where = ".".join(key)
    count[0] += 1
    if count[0] > _MOST_VALUES:
        raise InputError(f"{where}: expected at most {_MOST_VALUES} values, aliases written out, found more")
    if len(key) > _DEEPEST:
        raise InputError(f"{'.'.join(key[:3])}: expected at most {_DEEPEST} levels, found more (or an alias of itself)")
    if isinstance(value, dict):
        for name, child in value.items():
            if not isinstance(name, str):
                inside = f"{where}: " if where else ""
                raise InputError(f"{inside}expected words as keys, found {_short(name)}")
            _check_plain(child, (*key, name), count)
    elif isinstance(value, list):
        for place, child in enumerate(value):
            _check_plain(child, (*key, str(place)), count)
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where}: expected a finite number, found {value}")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{where}: expected an integer between -2^63 and 2^63, found one of {value.bit_length()} bits")
    elif not isinstance(value, str | int | float | None):
        kind = _KINDS.get(type(value), type(value).__name__)
        raise InputError(f"{where}: expected a number, a word, a list or keys, found a {kind}; words may be quoted")


def _short(value: Any) -> str:
    # Python refuses to convert integers of thousands of digits to text.
    text = repr(value) if not isinstance(value, int) or value.bit_length() < 64 else "a long integer"
    return text if len(text) <= 80 else f"{text[:76]} .."


def _sentence(error: Any) -> str:
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{key} is not a known key"
    if error["type"] == "missing":
        return f"{key} is missing"
    if error["input"] is None:
        return f"{key}: is empty, expected a value (keys that belong to it are indented below it)"
    message = error["msg"][0].lower() + error["msg"][1:]
    return f"{key}: {message}, found {_short(error['input'])}"

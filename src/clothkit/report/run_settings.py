"""Reads the settings that the report's pages mention from the params.yaml beside them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import pydantic
from ruamel.yaml import YAML, YAMLError

from clothkit.models.settings import EMDVoxelConfig, EnsembleConfig, PEMDConfig, VtMConfig
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.search import SearchConfig
from clothkit.runtime.errors import InputError, system_error
from clothkit.training.settings import TrainingConfig

T = TypeVar("T")

Net = PEMDConfig | EMDVoxelConfig | VtMConfig


@dataclass(frozen=True)
class TrainedNet:
    """Settings of a net and of its training."""

    net: Net
    training: TrainingConfig


@dataclass(frozen=True)
class RunSettings:
    """Settings of the run that a report is about."""

    text: str
    """The text of the file."""
    scale: str
    simulated: bool
    """Whether sequences come from our own simulator, which also executes plans."""
    varied: bool
    """Whether each sequence has a cloth and a start of its own."""
    beside_paper: bool
    """Whether the report has the paper's figures, too."""
    sequences: Mapping[str, int]
    """Largest number of sequences that are planned for, by split."""
    search: SearchConfig
    voxel_search: SearchConfig
    ensemble: EnsembleConfig
    pemd: TrainedNet
    emd_voxel: TrainedNet | None
    """None: the scale has no voxel baseline."""
    vtm: TrainedNet

    @property
    def canonical(self) -> bool:
        """Whether the mesh systems' forward models take each cloth in one canonical description as input."""
        return bool(getattr(self.pemd.net, "canonical", False))

    @property
    def voxels_canonical(self) -> bool:
        """Whether the voxel systems' forward models take canonical descriptions as input."""
        return self.emd_voxel is not None and bool(getattr(self.emd_voxel.net, "canonical", False))


def read(path: Path) -> RunSettings:
    """The settings in a params.yaml that the report stage wrote: those of one scale, defaults filled in.

    Raises InputError that names the file and the key that is missing or has an invalid value.
    """
    try:
        text = path.read_text()
        whole = YAML(typ="safe").load(text)
    except OSError as error:
        raise system_error(
            error, path, expected="the settings that the report stage leaves (dvc repro report)"
        ) from error
    except RecursionError as error:
        raise InputError(f"{path}: is not valid YAML (nested too deeply)") from error
    except (YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not valid YAML ({' '.join(str(error).split())})") from error
    scale = _at(path, whole, "scale")
    stages = _at(path, whole, f"scales.{scale}")
    baseline = _at(path, stages, "train_emd_voxel")
    return RunSettings(
        text=text,
        scale=scale,
        simulated=_at(path, stages, "simulate.source") == "own",
        # Older reports say neither: they are of the paper's cloth, beside its figures.
        varied=stages["simulate"].get("variation") is not None,
        beside_paper=(stages.get("report") or {}).get("paper", True),
        sequences={split: _at(path, stages, f"plan.{split}") for split in ("test", "train")},
        search=_search(path, stages, "plan.search"),
        voxel_search=_search(path, stages, "plan.voxel_search"),
        # Older reports do not say it: their ensembles are the paper's two nets.
        ensemble=_settings(path, whole, "ensemble", EnsembleConfig) if "ensemble" in whole else EnsembleConfig(),
        pemd=_trained_net(path, stages, "train_pemd", PEMDConfig),
        emd_voxel=_trained_net(path, stages, "train_emd_voxel", EMDVoxelConfig) if baseline is not None else None,
        vtm=_trained_net(path, stages, "train_vtm", VtMConfig),
    )


def _trained_net(path: Path, stages: Any, stage: str, net: type[Net]) -> TrainedNet:
    found = _at(path, stages, f"{stage}.net")
    if isinstance(found, dict) and "height" in found:  # as older reports call it
        found = {name: value for name, value in found.items() if name != "height"}
        found["viewport"] = {"height": _at(path, stages, f"{stage}.net.height")}
    return TrainedNet(
        _validated(path, f"{stage}.net", found, net), _settings(path, stages, f"{stage}.training", TrainingConfig)
    )


def _search(path: Path, stages: Any, key: str) -> SearchConfig:
    """The settings of a search; older reports have those of the gradient optimiser beside the others."""
    found = _at(path, stages, key)
    if not isinstance(found, dict) or "optimiser" in found:
        return _settings(path, stages, key, SearchConfig)
    own = {name: value for name, value in found.items() if name not in ("every", "fold")}
    optimiser = _validated(path, key, own, GradientConfig)
    return SearchConfig(optimiser=optimiser, stride=found.get("every", 1), fold=found.get("fold", False))


def _settings(path: Path, stages: Any, key: str, kind: type[T]) -> T:
    return _validated(path, key, _at(path, stages, key), kind)


def _validated(path: Path, key: str, found: Any, kind: type[T]) -> T:
    try:
        # Through JSON, because strict validation takes a list for a tuple only in JSON.
        return pydantic.TypeAdapter(kind).validate_json(pydantic.TypeAdapter(Any).dump_json(found), strict=True)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        at = ".".join(str(part) for part in (key, *first["loc"]))
        raise InputError(f"{path}: {at}: {first['msg'][0].lower()}{first['msg'][1:]}") from error


def _at(path: Path, found: Any, key: str) -> Any:
    """The value at a dotted key such as `plan.search`. Raises InputError when there is none."""
    for part in key.split("."):
        if not isinstance(found, dict) or part not in found:
            raise InputError(f"{path}: {key}: expected the report's settings there, found none")
        found = found[part]
    return found

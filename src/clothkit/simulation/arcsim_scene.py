"""Reader of the hand motions in an ARCSim run's conf.json: the grasped nodes, their times and their displacements."""

import math
import re
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pydantic
from annotated_types import Ge, Gt
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline

from clothkit.runtime.errors import InputError, system_error


class Handle(NamedTuple):
    """One grasped node, from grasp to release."""

    node: int
    """Index from 0 in the mesh that the run starts with."""
    start: float
    """s"""
    end: float
    """s"""
    move: Float[np.ndarray, "2"]
    """Displacement in xy from grasp to release, in metres."""


class Scene(NamedTuple):
    """The parts of a conf.json that an import needs."""

    frame_time: float
    """s"""
    handles: list[Handle]
    thickness: float
    """Distance of touching layers, in metres; NaN where the scene does not tell."""


# Keys of ARCSim that are not declared here are ignored.
class _Transform(pydantic.BaseModel, frozen=True, allow_inf_nan=False):
    translate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    rotate: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


class _Key(pydantic.BaseModel, frozen=True, allow_inf_nan=False):
    time: float
    transform: _Transform = _Transform()
    velocity: _Transform | None = None


class _Handle(pydantic.BaseModel, frozen=True, allow_inf_nan=False):
    type: str = "node"
    nodes: list[Annotated[int, Ge(0)]] = []
    label: int = -1
    motion: Annotated[int, Ge(-1)] = -1
    start_time: float = 0.0
    end_time: float = math.inf


class _Magic(pydantic.BaseModel, frozen=True, allow_inf_nan=False):
    repulsion_thickness: Annotated[float, Gt(0)] | None = None


class _Conf(pydantic.BaseModel, frozen=True, allow_inf_nan=False):
    frame_time: Annotated[float, Gt(0)]
    end_time: float = math.inf
    motions: list[list[_Key]] = []
    handles: list[_Handle] = []
    magic: _Magic = _Magic()


def read_scene(path: Path) -> Scene:
    """Read the scene of a run.

    Raises InputError that names the field if the file can't be read, a field is missing, there are no handles, a handle
    does not list its nodes, or a motion rotates or scales.
    """
    conf = _read(path)
    if not conf.handles:
        raise InputError(f"{path}: handles: expected one or two grasped nodes, found none")
    handles = []
    for number, handle in enumerate(conf.handles):
        where = f"{path}: handles.{number}"
        if handle.type != "node" or not handle.nodes:
            raise InputError(f"{where}: expected a handle of listed nodes, found {_kind(handle)}")
        if handle.motion >= len(conf.motions):
            raise InputError(f"{where}.motion: is {handle.motion}, but there are {len(conf.motions)} motions")
        keys = conf.motions[handle.motion] if handle.motion >= 0 else []
        move = np.zeros(2)
        if keys:
            _check_translation(path, handle.motion, keys)
            start, end = _translation(keys, handle.start_time), _translation(keys, handle.end_time)
            move = (end - start)[:2]
        handles += [Handle(node, handle.start_time, handle.end_time, move) for node in handle.nodes]
    return Scene(conf.frame_time, handles, conf.magic.repulsion_thickness or math.nan)


def _read(path: Path) -> _Conf:
    try:
        return _Conf.model_validate_json(_without_comments(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise system_error(error, path, expected="a scene of ARCSim") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: can't be read ({error})") from error
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise InputError(f"{path}: {field}: {first['msg'][0].lower()}{first['msg'][1:]}") from error


def _without_comments(text: str) -> str:
    """Return the text without comments, which ARCSim's JSON reader allows and which users' files may contain."""
    return re.sub(r'("(?:\\.|[^"\\])*")|//[^\n]*|/\*.*?\*/', lambda match: match[1] or "", text, flags=re.DOTALL)


def _kind(handle: _Handle) -> str:
    return f"one of type {handle.type!r}" if handle.type != "node" else f"label {handle.label} and no nodes"


def _check_translation(path: Path, motion: int, keys: list[_Key]) -> None:
    for number, key in enumerate(keys):
        if key.transform.scale != 1 or key.transform.rotate[0] % 360 != 0:
            raise InputError(f"{path}: motions.{motion}.{number}.transform: expected a translation only")
        if number and key.time <= keys[number - 1].time:
            raise InputError(f"{path}: motions.{motion}.{number}.time: expected later than the key before")


def _translation(keys: list[_Key], time: float) -> Float[np.ndarray, "3"]:
    """Return a motion's translation at a time, in metres: ARCSim's spline through its keys, constant outside them."""
    times = np.array([key.time for key in keys])
    places = np.array([key.transform.translate for key in keys])
    if time <= times[0] or len(keys) == 1:
        return places[0]
    if time >= times[-1]:
        return places[-1]
    slopes = np.zeros_like(places)
    slopes[1:-1] = (places[2:] - places[:-2]) / (times[2:] - times[:-2])[:, None]
    for slope, key in zip(slopes, keys, strict=True):
        if key.velocity is not None:
            slope[:] = key.velocity.translate
    return CubicHermiteSpline(times, places, slopes)(time)


def read_paths(path: Path, times: Float[np.ndarray, " times"]) -> list[tuple[Handle, Float[np.ndarray, "times 3"]]]:
    """Return each grasped node of a scene with its translation at each time, in metres; raises as `read_scene` does."""
    scene, conf = read_scene(path), _read(path)
    motions = [handle.motion for handle in conf.handles for _ in handle.nodes]
    keys = [conf.motions[motion] if motion >= 0 else [_Key(time=0.0)] for motion in motions]
    return [
        (handle, np.array([_translation(key, time) for time in times]))
        for handle, key in zip(scene.handles, keys, strict=True)
    ]


def read_end(path: Path) -> float:
    """Return the time at which the scene ends, in s; raises as `read_scene` does."""
    return _read(path).end_time

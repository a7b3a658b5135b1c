"""What a person's own program has of a cloth, a file or arrays in metres, as the observation of it."""

import dataclasses
from pathlib import Path

import numpy as np

from clothkit.app.inputs import Input, observed, read_state, with_mask
from clothkit.app.options import ObservationOptions
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.observation.arrays import from_array
from clothkit.observation.files import State
from clothkit.observation.states import MeshState, PointCloud
from clothkit.observation.surfaces import check_grid
from clothkit.runtime.errors import InputError

Observable = str | Path | np.ndarray | State | Input
"""What shows a cloth: a file that `clothkit plan` reads; a mesh [32, 32, 3] in metres, z up, the table at 0; voxels
[32, 32, 16]; points [n, 3] or [rows, columns, 3] in metres; or what one of these was read as."""

Mask = np.ndarray | str | Path
"""Which points of a cloud are the cloth's: 0 and 1, an element for each point, or an NPY file of these."""


def input_of(what: Observable, options: ObservationOptions, *, name: str, mask: Mask | None = None) -> Input:
    """The observation of a cloth; messages call arrays `name`. Raises InputError."""
    if isinstance(what, Input):
        return what
    state: State
    if isinstance(what, str | Path):
        name, state = str(what), read_state(what, options)
    else:
        state = _state_of(what, options, name) if isinstance(what, np.ndarray) else what
        if not isinstance(state, State):
            found = type(what).__name__
            raise InputError(f"{name}: expected a file's name, a NumPy array, or what was read, found {found}")
    if mask is not None:
        state = _masked(state, mask, name)
    return observed(state, options, name=name)


def _state_of(array: np.ndarray, options: ObservationOptions, name: str) -> State:
    """The state in an array. Unlike in files, meshes are in metres."""
    if array.shape != (*options.topology.shape, 3):
        return from_array(array, name=name, cloth_side=options.side, topology=options.topology)
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise InputError(f"{name}: has vertices that are not finite numbers, expected metres")
    check_grid(name, array, options.topology, side=options.side, unit="m")
    scale = options.side / CLOTH_LENGTH
    return MeshState(*centred((array / scale).astype(np.float32)), scale)


def _masked(state: State, mask: Mask, name: str) -> State:
    if isinstance(mask, str | Path):
        return with_mask(state, mask, name)
    if not isinstance(state, PointCloud):
        raise InputError(f"mask: is for points, but {name} holds none")
    mask = np.asarray(mask)
    if mask.size != len(state.points) or not np.isin(mask, (0, 1)).all():
        raise InputError(f"mask: expected {len(state.points)} of 0 and 1, one for each point of {name}")
    return dataclasses.replace(state, cloth=mask.reshape(-1).astype(bool))

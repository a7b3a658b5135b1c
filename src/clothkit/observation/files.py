"""Cloths and clouds in files: OBJ, PLY, GLB, PCD, NPY, NPZ, and arrays in zarr stores.

OBJ, PLY, GLB       a mesh in metres (`observation.surfaces`); a PLY without faces is a point cloud
PCD                 a point cloud in metres (`observation.pcd`)
NPY                 one array, told by its shape: mesh [32, 32, 3], normalised; voxels [32, 32, 16]; points [n, 3]
NPZ                 such an array; beside `points` there may be `cloth` [n], `colours` [n, 3] and `viewpoint` [3]
S.zarr:4/2          state 2 of sequence 4 of a store of meshes, data/meshes.zarr
S.zarr[:GROUP]      one array, as in NPY
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from clothkit.cloth.grid import CLOTH_SIDE, SIDE
from clothkit.cloth.silhouette import centred
from clothkit.cloth.voxels import RESOLUTION
from clothkit.dataset.store import STATES, open_meshes
from clothkit.dataset.zarr_store import check_shards, open_node, read_array
from clothkit.errors import InputError
from clothkit.observation.pcd import read_pcd
from clothkit.observation.states import MeshState, PointCloud, VoxelState
from clothkit.observation.surfaces import ENDINGS, check_grid, read_surface
from clothkit.simulation.settings import SimulationConfig

DEFAULT_SIDE = SimulationConfig().cloth_side
"""Side of the simulated cloth [m]."""
_SHAPES = "[32, 32, 3] (mesh), [32, 32, 16] (voxels) or [n, 3] (points)"
_EXTRAS = ("cloth", "colours", "viewpoint")
_ZARR = re.compile(r"(?P<store>.*\.zarr)(?::(?P<inside>.*))?")

State = MeshState | VoxelState | PointCloud


def read(source: str | Path, *, cloth_side: float = DEFAULT_SIDE, y_up: bool = False) -> State:
    """The state in a file, by its ending. Lengths are metres unless an array is normalised.

    `cloth_side` [m] is that of the flat cloth; `y_up` tells that OBJ and PLY meshes have y up. Raises InputError, one
    sentence, that names the file, what was expected and what was found.
    """
    if not (np.isfinite(cloth_side) and cloth_side > 0):
        raise InputError(f"{source}: cloth side {cloth_side:g}, expected metres above 0")
    inside = _ZARR.fullmatch(str(source))
    path = Path(inside["store"]) if inside else Path(source)
    ending = path.suffix.lower()
    if ending not in (*ENDINGS, ".pcd", ".npy", ".npz", ".zarr"):
        raise InputError(f"{path}: ending {ending!r} is not known, expected obj, ply, glb, pcd, npy, npz or zarr")
    if not path.exists():
        raise InputError(f"{path}: not found")
    if inside:
        return _read_zarr(path, inside["inside"], cloth_side)
    if not path.is_file():
        raise InputError(f"{path}: is a folder, expected a file")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: is empty, expected a cloth")
    if ending in ENDINGS:
        return read_surface(path, cloth_side=cloth_side, y_up=y_up)
    if ending == ".pcd":
        return read_pcd(path)
    return _read_numpy(path, cloth_side)


def _read_numpy(path: Path, cloth_side: float) -> State:
    try:
        # Opened here, because numpy leaves a file that it cannot read open.
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            arrays = {"array": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
    except Exception as error:  # of zipfile, zlib, struct, header parsing; numpy's advice to unpickle is none
        raise InputError(f"{path}: can't be read as {path.suffix[1:].upper()}, it is none or is broken") from error
    extras = {name: arrays.pop(name) for name in _EXTRAS if name in arrays}
    if len(arrays) > 1:
        known = [name for name in ("mesh", "vertices", "voxels", "points") if name in arrays]
        if len(known) != 1:
            raise InputError(f"{path}: holds {', '.join(arrays)}, expected one of mesh, voxels, points")
        arrays = {known[0]: arrays[known[0]]}
    if not arrays:
        raise InputError(f"{path}: holds no array {_SHAPES}")
    return from_array(next(iter(arrays.values())), name=str(path), cloth_side=cloth_side, **extras)


def from_array(
    array: np.ndarray,
    *,
    name: str,
    cloth_side: float = DEFAULT_SIDE,
    cloth: np.ndarray | None = None,
    colours: np.ndarray | None = None,
    viewpoint: np.ndarray | None = None,
) -> State:
    """The state that an array is, by its shape: a normalised mesh, voxels, or points [m] with what is known of them.

    `name` is what messages call it. Raises InputError when shape or values are none of these.
    """
    if array.dtype.kind not in "fiub":
        raise InputError(f"{name}: holds {array.dtype}, expected numbers")
    if array.shape == (SIDE, SIDE, 3):
        return _mesh(name, array.astype(np.float32), cloth_side)
    if array.shape == RESOLUTION:
        if not np.isin(array, (0, 1)).all():
            raise InputError(f"{name}: has voxels other than 0 and 1, expected occupancy")
        if not array.any():
            raise InputError(f"{name}: has no occupied voxel")
        return VoxelState(array.astype(bool))
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name}: has shape {list(array.shape)}, expected {_SHAPES}")
    count = len(array)
    with np.errstate(invalid="ignore"):
        points = array.astype(float)
    for field, value, shape in (
        ("cloth", cloth, (count,)),
        ("colours", colours, (count, 3)),
        ("viewpoint", viewpoint, (3,)),
    ):
        if value is not None and value.shape != shape:
            raise InputError(f"{name}: {field} has shape {list(value.shape)}, expected {list(shape)}")
    if cloth is not None and not np.isin(cloth, (0, 1)).all():
        raise InputError(f"{name}: cloth has values other than 0 and 1, expected a mask")
    if colours is not None and (colours.dtype.kind not in "iu" or colours.min() < 0 or colours.max() > 255):
        raise InputError(f"{name}: colours are not whole numbers 0 to 255")
    return PointCloud(
        points,
        cloth=None if cloth is None else cloth.astype(bool),
        colours=None if colours is None else colours.astype(np.uint8),
        viewpoint=None if viewpoint is None else viewpoint.astype(float),
    )


def _mesh(name: str, vertices: np.ndarray, cloth_side: float) -> MeshState:
    if not np.isfinite(vertices).all():
        raise InputError(f"{name}: has vertices that are not finite")
    check_grid(name, vertices, side=CLOTH_SIDE, unit="normalised")
    return MeshState(*centred(vertices), cloth_side / CLOTH_SIDE)


def _read_zarr(path: Path, inside: str | None, cloth_side: float) -> State:
    node: Any = open_node(path)
    name = f"{path}:{inside}" if inside else str(path)
    try:
        if isinstance(node, zarr.Group) and "vertices" in node and "centre" in node:
            return _stored(path, inside, cloth_side)
        node = node[inside] if inside else node
        arrays = [array for _, array in sorted(node.arrays())] if isinstance(node, zarr.Group) else [node]
    except InputError:
        raise
    except (KeyError, IndexError, TypeError) as error:
        raise InputError(f"{path}: has nothing called {inside}") from error
    except Exception as error:  # zarr tells of damaged metadata by many kinds of errors
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{name}: can't be read as zarr ({reason})") from error
    if len(arrays) != 1:
        raise InputError(f"{name}: is a group of {len(arrays)} arrays, expected one {_SHAPES}")
    if not isinstance(arrays[0], zarr.Array):
        raise InputError(f"{name}: is no array")
    # Nothing is allocated for what has no chance. Most voxels are empty: of theirs a chunk of zeros need not be there.
    shape = arrays[0].shape
    if shape not in ((SIDE, SIDE, 3), RESOLUTION) and (len(shape) != 2 or shape[1] != 3):
        raise InputError(f"{name}: has shape {list(shape)}, expected {_SHAPES}")
    check_shards(arrays[0], name, zeros=shape == RESOLUTION)
    return from_array(read_array(arrays[0], name), name=name, cloth_side=cloth_side)


def _stored(path: Path, inside: str | None, cloth_side: float) -> MeshState:
    """A state of our own store; only what it needs is read."""
    wanted = re.fullmatch(r"(\d+)/(\d+)", inside or "")
    if not wanted:
        raise InputError(f"{path}: is a store of meshes, expected {path.name}:SEQUENCE/STATE, found {inside or 'none'}")
    sequence, state = int(wanted[1]), int(wanted[2])
    name = f"{path}: sequence {sequence}, state {state}"
    store = open_meshes(path, ("vertices", "centre"))
    count = len(store)
    if sequence >= count or state >= STATES:
        raise InputError(f"{name}: not there, it holds sequences 0 to {count - 1} with states 0 to {STATES - 1}")
    vertices, centre = (store.read(part, slice(sequence, sequence + 1))[0, state] for part in ("vertices", "centre"))
    if np.isnan(vertices).all():
        raise InputError(f"{name}: not there, the sequence is shorter")
    if not (np.isfinite(vertices).all() and np.isfinite(centre).all()):
        raise InputError(f"{name}: vertices or centre is not finite")
    return MeshState(vertices, centre, cloth_side / CLOTH_SIDE)

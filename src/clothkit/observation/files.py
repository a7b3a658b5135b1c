"""Reads cloths and point clouds from files: OBJ, PLY, GLB, PCD, NPY, NPZ, and arrays in zarr stores.

OBJ, PLY, GLB       a mesh in metres (`observation.surfaces`); a PLY without faces is a point cloud
PCD                 a point cloud in metres (`observation.pcd`)
NPY                 one array; its shape decides: mesh [32, 32, 3], normalised; voxels [32, 32, 16]; points [n, 3]
NPZ                 such an array; with `points` also `cloth` [n], `colours` [n, 3] and `viewpoint` [3]
                    (`observation.arrays`); or a picture, `depth` or `silhouette`, and its camera
S.zarr:4/2          state 2 of sequence 4 of a store of meshes, data/meshes.zarr
S.zarr[:GROUP]      one array, as in NPY
"""

import re
import stat
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology
from clothkit.cloth.voxels import RESOLUTION
from clothkit.dataset.store import STATES, open_meshes
from clothkit.dataset.zarr_store import check_shards, open_node, read_array
from clothkit.observation.arrays import from_array, read_numpy, shapes
from clothkit.observation.pcd import read_pcd
from clothkit.observation.states import MeshState, PointCloud, SilhouetteState, VoxelState
from clothkit.observation.surfaces import ENDINGS, read_surface
from clothkit.runtime.errors import InputError, system_error
from clothkit.simulation.settings import SimulationConfig

DEFAULT_SIDE = SimulationConfig().cloth_side
"""Side of the simulated cloth [m]."""
_ZARR = re.compile(r"(?P<store>.*\.zarr)(?::(?P<inside>.*))?")

State = MeshState | VoxelState | PointCloud | SilhouetteState


def read(
    source: str | Path,
    *,
    cloth_side: float = DEFAULT_SIDE,
    y_up: bool = False,
    as_points: bool = False,
    topology: Topology = SQUARE,
) -> State:
    """The state in a file; the file's ending decides how it is read. Lengths are metres unless an array is normalised.

    `cloth_side` is the side of the flat cloth, the longer one if it is no square [m]. `y_up` states that OBJ and PLY
    meshes have y up. `as_points` reads the vertices of a mesh that is not the topology's grid as points that a camera
    measured. A store of meshes holds SQUARE's grids alone. Raises InputError, one sentence, that
    names the file, what was expected and what was found.
    """
    if not (np.isfinite(cloth_side) and cloth_side > 0):
        raise InputError(f"{source}: cloth side {cloth_side:g}, expected metres above 0")
    inside = _ZARR.fullmatch(str(source))
    path = Path(inside["store"]) if inside else Path(source)
    ending = path.suffix.lower()
    if ending not in (*ENDINGS, ".pcd", ".npy", ".npz", ".zarr"):
        raise InputError(f"{path}: ending {ending!r} is not known, expected obj, ply, glb, pcd, npy, npz or zarr")
    try:
        found = path.stat()
    except OSError as error:
        raise system_error(error, path) from error
    if inside:
        return _read_zarr(path, inside["inside"], cloth_side, topology)
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is {'a folder' if path.is_dir() else 'no regular file'}, expected a file")
    if found.st_size == 0:
        raise InputError(f"{path}: is empty, expected a cloth")
    if ending in ENDINGS:
        return read_surface(path, cloth_side=cloth_side, y_up=y_up, as_points=as_points, topology=topology)
    if ending == ".pcd":
        return read_pcd(path)
    return read_numpy(path, cloth_side=cloth_side, topology=topology)


def _read_zarr(path: Path, inside: str | None, cloth_side: float, topology: Topology) -> State:
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
    except Exception as error:  # zarr raises many kinds of errors for damaged metadata
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{name}: can't be read as zarr ({reason})") from error
    if len(arrays) != 1:
        raise InputError(f"{name}: is a group of {len(arrays)} arrays, expected one {shapes(topology)}")
    if not isinstance(arrays[0], zarr.Array):
        raise InputError(f"{name}: is no array")
    # The shape is checked before memory is allocated. Zarr may leave out chunks of zeros, and most voxels are empty, so
    # voxels may lack chunks.
    shape = arrays[0].shape
    if shape not in ((*topology.shape, 3), RESOLUTION) and (len(shape) != 2 or shape[1] != 3):
        raise InputError(f"{name}: has shape {list(shape)}, expected {shapes(topology)}")
    check_shards(arrays[0], name, zeros=shape == RESOLUTION)
    return from_array(read_array(arrays[0], name), name=name, cloth_side=cloth_side, topology=topology)


def _stored(path: Path, inside: str | None, cloth_side: float) -> MeshState:
    """A state of a store of meshes. Only its sequence is read."""
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
    return MeshState(vertices, centre, cloth_side / CLOTH_LENGTH)

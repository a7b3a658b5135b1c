"""Reads cloths and point clouds from NumPy files: one array in NPY, several named arrays in NPZ.

The shape of an array decides whether it is a mesh, voxels or points. Pickled objects are refused. Arrays of an NPZ file
that have no known role are not read.
"""

import io
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology
from clothkit.cloth.voxels import RESOLUTION
from clothkit.observation.colours import as_bytes, colours_of
from clothkit.observation.states import MeshState, PointCloud, SilhouetteState, VoxelState, named
from clothkit.observation.surfaces import check_grid
from clothkit.runtime.errors import InputError, system_error

_STATES = {
    "mesh": ("mesh", "vertices", "verts"),
    "voxels": ("voxels", "occupancy"),
    "points": ("points", "point_cloud", "pointcloud", "cloud", "pcd", "xyz", "pts", "positions"),
    "depth": ("depth", "depth_image", "depth_map"),
    "silhouette": ("silhouette",),
}
_EXTRAS = {
    "cloth": ("cloth", "mask", "cloth_mask", "segmentation", "seg"),
    "colours": ("colours", "colors", "rgb", "colour", "color"),
    "viewpoint": ("viewpoint", "view_point", "camera_position"),
    "intrinsics": ("k", "intrinsics", "camera_matrix"),
    "pixel": ("pixel", "metres_per_pixel", "meters_per_pixel"),
}
_PICTURES = {"depth": ("intrinsics",), "silhouette": ("intrinsics", "pixel")}
"""States that are a camera's picture, the one that tells more first, and what is known of the camera."""
_LEAST_IMAGE = 60
"""Least rows and columns of an array [rows, columns, 3] that is read as a camera's image of points.

A smaller array is taken for a mesh of another grid size and refused.
"""


def shapes(topology: Topology) -> str:
    """The shapes of the arrays that are read, for messages."""
    rows, columns = topology.shape
    return f"[{rows}, {columns}, 3] (mesh), [32, 32, 16] (voxels) or [n, 3] (points)"


def read_numpy(
    path: Path, *, cloth_side: float, topology: Topology = SQUARE
) -> MeshState | VoxelState | PointCloud | SilhouetteState:
    """The state in an NPY or NPZ file. Raises InputError that names what the file has and what was expected."""
    try:
        if path.suffix.lower() == ".npy":
            return from_array(
                _array(str(path), path.read_bytes()), name=str(path), cloth_side=cloth_side, topology=topology
            )
        with zipfile.ZipFile(path) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            names = _chosen(path, members, topology)
            arrays = {role: _array(f"{path}: {name}", archive.read(members[name])) for role, name in names.items()}
    except InputError:
        raise
    except Exception as error:  # zipfile, zlib, struct, NumPy and the system raise many kinds of errors
        if isinstance(error, OSError) and error.errno:
            raise system_error(error, path, expected="a cloth") from error
        raise InputError(f"{path}: can't be read as {path.suffix[1:].upper()}, it is none or is broken") from error
    unread = tuple(name for name in members if name not in names.values())
    state = next(role for role in names if role not in _EXTRAS)
    extras = {role: array for role, array in arrays.items() if role in _EXTRAS}
    if state == "silhouette":
        return _silhouette(str(path), arrays["silhouette"], unread, **extras)
    if state == "depth":
        arrays["depth"] = back_projected(str(path), arrays["depth"], extras.pop("intrinsics", None))
        extras.setdefault("viewpoint", np.zeros(3))
    return from_array(arrays[state], name=str(path), cloth_side=cloth_side, topology=topology, unread=unread, **extras)


def _chosen(path: Path, names: Iterable[str], topology: Topology) -> dict[str, str]:
    """The name of the array for each role.

    If no array has the known name of a state and exactly one array is left, its role is "array": a state whose kind
    follows from its shape. Raises InputError when there is no state or more than one array for a role.
    """
    names = list(names)
    found: dict[str, str] = {}
    for role, known in {**_STATES, **_EXTRAS}.items():
        several = [name for name in names if name.lower() in known]
        if len(several) > 1:
            raise InputError(f"{path}: holds {' and '.join(several)}, of which only one can be the {role}")
        if several:
            found[role] = several[0]
    # Beside points, a picture of them and its camera tell nothing more.
    states = [role for role in _STATES if role in found]
    for picture in _PICTURES:
        if picture in states[1:]:
            del found[picture]
    known = _PICTURES.get(states[0], ()) if states else ()
    for role in {role for roles in _PICTURES.values() for role in roles} - {*known}:
        found.pop(role, None)
    states = [role for role in found if role in _STATES]
    others = [name for name in names if name not in found.values()]
    if not states and len(others) == 1:
        found["array"] = others[0]
    elif len(states) != 1:
        if not names:
            raise InputError(f"{path}: holds no array {shapes(topology)}")
        raise InputError(
            f"{path}: has {named(names)}; expected one of mesh, voxels, points, and beside points cloth, colours "
            "and viewpoint"
        )
    return found


def _array(name: str, content: bytes) -> np.ndarray:
    """The array in the bytes of an NPY file. The header's size is checked against the bytes before memory is allocated.

    Raises InputError when the array holds Python objects or is larger than the bytes.
    """
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise InputError(f"{name}: holds Python objects, expected numbers")
    # Python integers, because NumPy's could overflow for a malformed shape.
    bytes_said = dtype.itemsize
    for length in shape:
        bytes_said *= length
    left = len(content) - file.tell()
    if bytes_said > left:
        raise InputError(f"{name}: says that it is an array {list(shape)}, but has {left} bytes of data")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def back_projected(name: str, depth: np.ndarray, intrinsics: np.ndarray | None) -> Float[np.ndarray, "rows columns 3"]:
    """The point [m] that each pixel of a depth image shows, in the camera's frame; (0, 0, 0) where there is none.

    Depth is along the camera's z: whole numbers are millimetres, others metres; 0 and what is not finite was not
    measured. `intrinsics` is the camera's matrix [3, 3], fx 0 cx, 0 fy cy, 0 0 1 in pixels, for which the first pixel's
    centre is at 0, 0. Raises InputError, in which the image is that of `name`, unless they have these forms.
    """
    if depth.ndim != 2 or depth.dtype.kind not in "fiu":
        raise InputError(f"{name}: depth is {depth.dtype} {list(depth.shape)}, expected numbers [rows, columns]")
    if intrinsics is None:
        raise InputError(f"{name}: has depth but no K, the camera's matrix [3, 3], expected both")
    (fx, _, cx), (_, fy, cy) = _checked(name, intrinsics)[:2].tolist()
    metres = depth.astype(float) * (1 if depth.dtype.kind == "f" else 0.001)
    metres = np.where(np.isfinite(metres), metres, 0)
    rows, columns = depth.shape
    x, y = np.meshgrid((np.arange(columns) - cx) / fx, (np.arange(rows) - cy) / fy)
    return np.stack([x * metres, y * metres, metres], axis=-1)


def _checked(name: str, intrinsics: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """A camera's matrix. Raises InputError unless it has that form."""
    if intrinsics.shape != (3, 3) or intrinsics.dtype.kind not in "fiu":
        raise InputError(f"{name}: K has shape {list(intrinsics.shape)}, expected the camera's matrix [3, 3]")
    found = intrinsics.astype(float)
    (fx, skew, cx), (zero, fy, cy), last = found.tolist()
    if not np.isfinite([fx, fy, cx, cy]).all() or min(fx, fy) <= 0 or skew or zero or last != [0, 0, 1]:
        raise InputError(f"{name}: K is {intrinsics.tolist()}, expected fx 0 cx, 0 fy cy, 0 0 1 with fx and fy above 0")
    return found


def _silhouette(
    name: str,
    silhouette: np.ndarray,
    unread: tuple[str, ...],
    *,
    intrinsics: np.ndarray | None = None,
    pixel: np.ndarray | None = None,
    **extras: np.ndarray,
) -> SilhouetteState:
    """The silhouette in an array [rows, columns]. Raises InputError."""
    pixels = _binary(silhouette) if silhouette.ndim == 2 else None
    if pixels is None:
        raise InputError(
            f"{name}: silhouette is {silhouette.dtype} {list(silhouette.shape)}, expected [rows, columns] of 0 and 1 "
            "(or 255)"
        )
    if not pixels.any():
        raise InputError(f"{name}: silhouette has no pixel that is the cloth's")
    told = _notices(name, (*unread, *extras))
    if pixel is not None:
        side = float(pixel) if pixel.size == 1 and pixel.dtype.kind in "fiu" else np.nan
        if not (np.isfinite(side) and side > 0):
            raise InputError(f"{name}: pixel is {pixel.tolist()}, expected the side of a pixel in metres")
        return SilhouetteState(pixels, pixel=side, notices=told)
    if intrinsics is None:
        raise InputError(
            f"{name}: has silhouette but neither pixel, the side of a pixel in metres, nor K, the camera's matrix "
            "[3, 3]"
        )
    return SilhouetteState(pixels, intrinsics=_checked(name, intrinsics), notices=told)


def from_array(
    array: np.ndarray,
    *,
    name: str,
    cloth_side: float,
    topology: Topology = SQUARE,
    cloth: np.ndarray | None = None,
    colours: np.ndarray | None = None,
    viewpoint: np.ndarray | None = None,
    unread: tuple[str, ...] = (),
) -> MeshState | VoxelState | PointCloud:
    """The state in an array, chosen by its shape: a normalised mesh, voxels, or points [m] with their attributes.

    Points may also have the shape [rows, columns, 3] of a camera's image, or be a structured array with columns x, y, z
    and colours. Messages call the array `name`; `unread` lists the file's other arrays. Raises InputError when shape or
    values fit none of these.
    """
    told = _notices(name, unread)
    if array.dtype.names:
        return _table(name, array, unread, told)
    if array.dtype.kind not in "fiub":
        raise InputError(f"{name}: holds {array.dtype}, expected numbers")
    if array.shape == (*topology.shape, 3):
        return _mesh(name, array.astype(np.float32), cloth_side, topology, told)
    if array.shape == RESOLUTION:
        voxels = _binary(array)
        if voxels is None:
            raise InputError(f"{name}: has voxels other than 0 and 1, expected occupancy")
        if not voxels.any():
            raise InputError(f"{name}: has no occupied voxel")
        return VoxelState(voxels, told)
    image = array.ndim == 3 and array.shape[2] == 3 and min(array.shape[:2]) >= _LEAST_IMAGE
    if not image and (array.ndim != 2 or array.shape[1] != 3):
        raise InputError(f"{name}: has shape {list(array.shape)}, expected {shapes(topology)}{_remedy(array.shape)}")
    shape = array.shape[:-1]
    count = int(np.prod(shape))
    fields = (("cloth", cloth, ()), ("colours", colours, (3,)))
    for field, value, each in fields:
        if value is not None and value.shape not in ((*shape, *each), (count, *each)):
            raise InputError(f"{name}: {field} has shape {list(value.shape)}, expected {[*shape, *each]}")
    if viewpoint is not None and viewpoint.shape != (3,):
        raise InputError(f"{name}: viewpoint has shape {list(viewpoint.shape)}, expected [3]")
    mask = None if cloth is None else _binary(cloth.reshape(count))
    if cloth is not None and mask is None:
        raise InputError(f"{name}: cloth has values other than 0 and 1 (or 255), expected a mask")
    rgb = None if colours is None else as_bytes(colours.reshape(count, 3))
    if colours is not None and rgb is None:
        raise InputError(f"{name}: colours are neither whole numbers 0 to 255 nor shares 0 to 1")
    with np.errstate(invalid="ignore"):
        points = array.astype(float).reshape(count, 3)
    seen_from = None if viewpoint is None else viewpoint.astype(float)
    return PointCloud(points, cloth=mask, colours=rgb, viewpoint=seen_from, unread=unread, notices=told)


def _binary(array: np.ndarray) -> Bool[np.ndarray, "*shape"] | None:
    """The mask of the values that are not 0; None unless all values are 0 and 1, or 0 and 255 as in images."""
    for one in (1, 255):
        if np.isin(array, (0, one)).all():
            return array == one
    return None


def _table(name: str, table: np.ndarray, unread: tuple[str, ...], notices: tuple[str, ...]) -> PointCloud:
    """The point cloud in a structured array, as made from ROS messages."""
    columns = {column: table[column].ravel() for column in table.dtype.names or () if table[column].dtype.kind in "fiu"}
    if not all(axis in columns and len(columns[axis]) == table.size for axis in "xyz"):
        raise InputError(f"{name}: is a table of {', '.join(table.dtype.names or ())}, expected numbers x, y, z")
    with np.errstate(invalid="ignore"):
        points = np.stack([columns[axis].astype(float) for axis in "xyz"], axis=-1)
        return PointCloud(points, colours=colours_of(columns), unread=unread, notices=notices)


def _mesh(
    name: str, vertices: np.ndarray, cloth_side: float, topology: Topology, notices: tuple[str, ...]
) -> MeshState:
    if not np.isfinite(vertices).all():
        raise InputError(f"{name}: has vertices that are not finite")
    check_grid(name, vertices, topology, side=CLOTH_LENGTH, unit="normalised")
    return MeshState(*centred(vertices), cloth_side / CLOTH_LENGTH, notices)


def _notices(name: str, unread: tuple[str, ...]) -> tuple[str, ...]:
    if not unread:
        return ()
    return (
        f"{name}: {named(unread)} {'is' if len(unread) == 1 else 'are'} not read; of names beside the points, cloth, "
        "colours and viewpoint are known",
    )


def _remedy(shape: tuple[int, ...]) -> str:
    """The end of an error message: how to make an array with nearly the right shape an array of points."""
    if len(shape) == 2 and shape[0] == 3:
        return "; transpose it"
    if len(shape) == 2 and shape[1] in (4, 6, 7):
        return "; save the columns x, y, z alone, and what else is known of them beside them in an NPZ"
    return ""

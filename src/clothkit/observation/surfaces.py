"""Triangle meshes in OBJ, PLY and GLB files, by trimesh.

OBJ and PLY have z up, GLB y up, the table is at height 0: as `dataset.export` writes them. A mesh of our grid, in its
own order of vertices, is a mesh state. Any other surface says nothing of which point of the cloth is where, so it
becomes what a camera straight above would see: a dense point cloud, layers below others hidden.
"""

from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

from clothkit.cloth.grid import CLOTH_SIDE, SIDE
from clothkit.cloth.grid import triangles as grid_triangles
from clothkit.cloth.silhouette import centred
from clothkit.errors import InputError
from clothkit.observation.heights import MESH_REMEDY, check_above, check_lying
from clothkit.observation.plane import LEVEL
from clothkit.observation.states import MeshState, PointCloud
from clothkit.observation.zbuffer import topmost

ENDINGS = (".obj", ".ply", ".glb")
_PITCH = 0.005
"""Distance of the points that a surface is sampled at, as a share of the cloth's side."""
_OFF_TABLE = 0.1
"""How far from height 0 the lowest vertex may be, as a share of the cloth's side."""
_NARROWEST, _WIDEST = 0.8, 1.2
"""How wide a grid may be along its edges, in cloth sides: cloths stretch, and files may round."""
_MOST_SPAN = 1.6
"""What a cloth may span along one axis, in cloth sides: its diagonal, and some slack."""


def read_surface(path: Path, *, cloth_side: float, y_up: bool = False) -> MeshState | PointCloud:
    """The state in a mesh file; a PLY without faces is the point cloud that it holds.

    `y_up` tells that an OBJ or PLY mesh has y up, as GLB always has. Points stay as they are.

    Raises InputError when the file can't be read, or does not hold a cloth of `cloth_side` [m] on the table.
    """
    try:
        loaded = trimesh.load_scene(path, process=False)
        parts = loaded.dump()
    except Exception as error:  # trimesh's readers raise what they like: KeyError, IndexError, struct.error, ...
        raise InputError(f"{path}: can't be read as {path.suffix[1:].upper()} ({_first_line(error)})") from error
    if len(parts) != 1:
        raise InputError(f"{path}: holds {len(parts)} objects, expected one cloth")
    part = parts[0]
    vertices = np.asarray(getattr(part, "vertices", np.zeros((0, 3))), float)
    if not len(vertices):
        raise InputError(f"{path}: holds no vertices")
    faces = getattr(part, "faces", None)
    if isinstance(part, trimesh.PointCloud) or faces is None or not len(faces):
        if path.suffix.lower() != ".ply":
            raise InputError(f"{path}: holds no triangles")
        return PointCloud(vertices, colours=_colours(part, len(vertices)))
    if y_up or path.suffix.lower() == ".glb":
        vertices = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=-1)
    faces = np.asarray(faces)
    if not np.isfinite(vertices).all():
        raise InputError(f"{path}: has vertices that are not finite")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path}: has triangles between vertices that it doesn't hold, there are {len(vertices)}")
    grid = is_grid(len(vertices), faces)
    if grid:
        check_grid(str(path), vertices.reshape(SIDE, SIDE, 3), side=cloth_side, unit="m")
    else:
        check_span(str(path), vertices, side=cloth_side, unit="m")
    check_lying(str(path), vertices, side=cloth_side, remedy=MESH_REMEDY)
    lowest = vertices[:, 2].min()
    if not abs(lowest) <= _OFF_TABLE * cloth_side:
        raise InputError(
            f"{path}: its lowest vertex is at height {lowest:.3g} m, expected the table at 0 (z up in OBJ and PLY, "
            "y up in GLB) and metres"
        )
    check_above(str(path), vertices, side=cloth_side, remedy=MESH_REMEDY)
    if not grid:
        return from_above(vertices, faces, pitch=_PITCH * cloth_side)
    scale = cloth_side / CLOTH_SIDE
    mesh, centre = centred((vertices / scale).astype(np.float32).reshape(SIDE, SIDE, 3))
    return MeshState(mesh, centre, scale)


def is_grid(vertices: int, faces: Int[np.ndarray, "faces 3"]) -> bool:
    """Whether triangles are those of our grid: two within each quad, on whichever diagonal."""
    if vertices != SIDE**2 or len(faces) != 2 * (SIDE - 1) ** 2:
        return False
    u, v = np.divmod(faces, SIDE)
    within = (np.ptp(u, axis=1) == 1) & (np.ptp(v, axis=1) == 1)
    quads = np.bincount(u.min(1) * SIDE + v.min(1), minlength=SIDE**2)
    return bool(within.all() and (quads <= 2).all() and quads.sum() == len(grid_triangles()))


def check_grid(name: str, mesh: Float[np.ndarray, "u v 3"], *, side: float, unit: str) -> None:
    """That a grid is as wide as the cloth along its edges, folded or not, in a named unit. Raises InputError."""
    edges = [np.median(np.linalg.norm(np.diff(mesh.astype(float), axis=axis), axis=-1)) for axis in (0, 1)]
    found = float(np.mean(edges)) * (mesh.shape[0] - 1)
    if not _NARROWEST <= found / side <= _WIDEST:
        raise InputError(
            f"{name}: the mesh's side is {found:.3g} along its edges, expected the cloth's, {side:g} {unit}"
        )
    check_span(name, mesh.reshape(-1, 3), side=side, unit=unit)


def check_span(name: str, vertices: Float[np.ndarray, "vertices 3"], *, side: float, unit: str) -> None:
    """That nothing spans more than the cloth's diagonal. Raises InputError."""
    span = float(np.ptp(vertices.astype(float), axis=0).max())
    if span > _MOST_SPAN * side:
        raise InputError(f"{name}: spans {span:.3g}, expected a cloth of side {side:g} {unit}; check its unit")


def from_above(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], *, pitch: float
) -> PointCloud:
    """The points of a surface that are seen from straight above, `pitch` [m] apart; the table is z = 0."""
    low, span = vertices[:, :2].min(0), np.ptp(vertices[:, :2], axis=0)
    rows, columns = (int(n) for n in np.ceil(span / pitch) + 1)
    # Rows run along x here.
    places = (vertices[:, 1::-1] - low[::-1]) / pitch
    heights, owner = topmost(places[faces], vertices[:, 2][faces], (rows, columns))
    row, column = np.nonzero(owner >= 0)
    points = np.stack([*(low[:, None] + (np.stack([row, column]) + 0.5) * pitch), heights[row, column]], axis=-1)
    return PointCloud(points, table=LEVEL)


def _colours(part: object, count: int) -> np.ndarray | None:
    colours = np.asarray(getattr(part, "colors", np.zeros((0, 4))))
    return colours[:, :3].astype(np.uint8) if colours.shape == (count, 4) else None


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]

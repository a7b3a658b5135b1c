"""Triangle meshes in OBJ, PLY and GLB files.

OBJ and PLY have z up, GLB y up, the table is at height 0: as `dataset.export` writes them. A mesh of our grid, in
whatever order of vertices, is a mesh state. Any other surface says nothing of which point of the cloth is where, so it
becomes what a camera straight above would see: a dense point cloud, layers below others hidden.

A file may also hold what a camera measured: points without faces, or, where its program has meshed them, with faces.
"""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth.grid import CLOTH_SIDE, SIDE
from clothkit.cloth.silhouette import centred
from clothkit.errors import InputError, system_error
from clothkit.observation.grids import grid_order
from clothkit.observation.heights import MESH_REMEDY, check_above, check_lying
from clothkit.observation.parts import Loaded, check_joined, load
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
_FARTHEST = 1e7
"""In cloth sides: a mesh in micrometres is told that its unit is wrong, one beyond is none."""
_SAME_PLACE = 1e-5
"""How near vertices are that count as one, as a share of the cloth's side."""
_MESHED = "holds a mesh with colours that does not lie on z = 0: taken for points that a camera measured, without faces"


def read_surface(
    path: Path, *, cloth_side: float, y_up: bool = False, as_points: bool = False
) -> MeshState | PointCloud:
    """The state in a mesh file; a PLY without faces is the point cloud that it holds.

    `y_up` tells that an OBJ or PLY mesh has y up, as GLB always has. Points stay as they are.
    `as_points` takes the vertices of what is no grid for what a camera measured, wherever they lie, and leaves faces
    out. So is, without being asked for, a PLY whose vertices have colours and that is neither a grid nor on the table.

    Raises InputError when the file can't be read, or does not hold a cloth of `cloth_side` [m] on the table.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise system_error(error, path, expected="a mesh") from error
    ply = path.suffix.lower() == ".ply"
    loaded = load(path, content)
    vertices, faces, tolerance = loaded.vertices, loaded.faces, _SAME_PLACE * cloth_side
    if path.suffix.lower() == ".glb":
        vertices = _z_up(vertices)
    points = PointCloud(vertices, colours=loaded.colours)
    if not len(faces):
        if as_points or ply:
            return points
        raise InputError(f"{path}: holds no triangles; if its vertices are what a camera measured, give --as-points")
    if y_up and path.suffix.lower() != ".glb":
        vertices = _z_up(vertices)
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3)
    # So written, what is not a number counts as far away, too.
    finite = bool((np.abs(vertices) < _FARTHEST * cloth_side).all())
    order = grid_order(vertices, faces, tolerance=tolerance) if finite else None
    if order is None and as_points:
        return points
    if not finite:
        raise InputError(f"{path}: has vertices that are not finite, or farther away than any cloth's")
    if order is None and ply and points.colours is not None and not _on_table(vertices, cloth_side):
        return dataclasses.replace(points, notices=(f"{path}: {_MESHED}",))
    return _surface(path, loaded._replace(vertices=vertices, faces=faces), order, cloth_side, tolerance)


def _z_up(vertices: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, "vertices 3"]:
    """Vertices with y up as vertices with z up."""
    return np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=-1)


def _surface(
    path: Path, loaded: Loaded, order: Int[np.ndarray, "1024"] | None, cloth_side: float, tolerance: float
) -> MeshState | PointCloud:
    """A cloth of finite vertices, z up, as a mesh in the given order, or as it is seen from above."""
    vertices = loaded.vertices
    if order is not None:
        vertices = vertices[order]
        check_grid(str(path), vertices.reshape(SIDE, SIDE, 3), side=cloth_side, unit="m")
    else:
        check_joined(path, loaded, tolerance=tolerance)
        check_span(str(path), vertices, side=cloth_side, unit="m", meshed=True)
    check_lying(str(path), vertices, side=cloth_side, remedy=MESH_REMEDY)
    if not _on_table(vertices, cloth_side):
        raise InputError(
            f"{path}: its lowest vertex is at height {vertices[:, 2].min():.3g} m, expected the table at 0 (z up in "
            "OBJ and PLY, y up in GLB) and metres"
        )
    check_above(str(path), vertices, side=cloth_side, remedy=MESH_REMEDY)
    if order is None:
        return from_above(vertices, loaded.faces, pitch=_PITCH * cloth_side)
    scale = cloth_side / CLOTH_SIDE
    mesh, centre = centred((vertices / scale).astype(np.float32).reshape(SIDE, SIDE, 3))
    return MeshState(mesh, centre, scale)


def _on_table(vertices: Float[np.ndarray, "vertices 3"], cloth_side: float) -> bool:
    return bool(abs(vertices[:, 2].min()) <= _OFF_TABLE * cloth_side)


def check_grid(name: str, mesh: Float[np.ndarray, "u v 3"], *, side: float, unit: str) -> None:
    """That a grid is as wide as the cloth along its edges, folded or not, in a named unit. Raises InputError."""
    edges = [np.median(np.linalg.norm(np.diff(mesh.astype(float), axis=axis), axis=-1)) for axis in (0, 1)]
    found = float(np.mean(edges)) * (mesh.shape[0] - 1)
    if not _NARROWEST <= found / side <= _WIDEST:
        raise InputError(
            f"{name}: the mesh's side is {found:.3g} along its edges, expected the cloth's, {side:g} {unit}"
        )
    check_span(name, mesh.reshape(-1, 3), side=side, unit=unit)


def check_span(
    name: str, vertices: Float[np.ndarray, "vertices 3"], *, side: float, unit: str, meshed: bool = False
) -> None:
    """That nothing spans more than the cloth's diagonal; `meshed` may be what a camera saw. Raises InputError."""
    span = float(np.ptp(vertices.astype(float), axis=0).max())
    if span > _MOST_SPAN * side:
        other = ", or give --as-points if its vertices are what a camera measured" if meshed else ""
        raise InputError(f"{name}: spans {span:.3g}, expected a cloth of side {side:g} {unit}; check its unit{other}")


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
    return PointCloud(points, table=LEVEL, surface=True)

"""Reads triangle meshes in OBJ, PLY and GLB files.

OBJ and PLY have z up, GLB has y up, and the table is at height 0, as in the files that `dataset.export` writes. A mesh
of the cloth's grid, with its vertices in any order, becomes a mesh state. Any other surface does not show which point
of the cloth is where, so it becomes what a camera straight above would measure: a dense point cloud without hidden
layers.

A file may also hold points that a camera measured, without faces or, if a program has meshed them, with faces.
"""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE, Topology
from clothkit.observation.grids import grid_order, widths
from clothkit.observation.heights import MESH_REMEDY, check_above, check_lying
from clothkit.observation.parts import Loaded, check_joined, load
from clothkit.observation.plane import LEVEL
from clothkit.observation.states import MeshState, PointCloud
from clothkit.observation.zbuffer import topmost
from clothkit.runtime.errors import InputError, system_error

ENDINGS = (".obj", ".ply", ".glb")
_PITCH = 0.005
"""Distance between the points at which a surface is sampled, as a share of the cloth's side."""
_OFF_TABLE = 0.1
"""Largest distance of the lowest vertex from height 0, as a share of the cloth's side."""
_NARROWEST, _WIDEST = 0.8, 1.2
"""Least and largest width of a grid along its edges, in cloth sides: cloths stretch, and files may round."""
_MOST_SPAN = 1.6
"""Largest span of a cloth along one axis, in cloth sides: its diagonal, and some slack."""
_FARTHEST = 1e7
"""Largest coordinate, in cloth sides: a mesh in micrometres stays below it and is refused for its unit."""
_SAME_PLACE = 1e-5
"""Distance below which vertices are merged, as a share of the cloth's side."""
_MESHED = "holds a mesh with colours that does not lie on z = 0: taken for points that a camera measured, without faces"


def read_surface(
    path: Path, *, cloth_side: float, y_up: bool = False, as_points: bool = False, topology: Topology = SQUARE
) -> MeshState | PointCloud:
    """The state in a mesh file: a mesh of the topology's grid or a point cloud.

    `y_up` states that an OBJ or PLY mesh has y up, as GLB always has; points are not turned. `as_points` reads the
    vertices of a mesh that is not this grid as points that a camera measured, wherever they lie, and leaves out the
    faces. A PLY mesh is read in this way without `as_points`, too, if its vertices have colours and it is neither this
    grid nor on the table. A PLY without faces is a point cloud.

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
    # With `<`, NaN counts as too far away, too.
    finite = bool((np.abs(vertices) < _FARTHEST * cloth_side).all())
    order = grid_order(vertices, faces, topology, tolerance=tolerance) if finite else None
    if order is None and as_points:
        return points
    if not finite:
        raise InputError(f"{path}: has vertices that are not finite, or farther away than any cloth's")
    if order is None and ply and points.colours is not None and not _on_table(vertices, cloth_side):
        return dataclasses.replace(points, notices=(f"{path}: {_MESHED}",))
    return _surface(path, loaded._replace(vertices=vertices, faces=faces), order, cloth_side, tolerance, topology)


def _z_up(vertices: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, "vertices 3"]:
    """Vertices with y up, turned so that z is up."""
    return np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=-1)


def _surface(
    path: Path,
    loaded: Loaded,
    order: Int[np.ndarray, " grid"] | None,
    cloth_side: float,
    tolerance: float,
    topology: Topology,
) -> MeshState | PointCloud:
    """The state of a cloth with finite vertices, z up: a mesh if `order` is given, else its points seen from above.

    `order` lists the vertices of the topology's grid row by row. Raises InputError when the cloth has another size,
    consists of several parts, stands upright, or does not lie on the table.
    """
    vertices = loaded.vertices
    if order is not None:
        vertices = vertices[order]
        check_grid(str(path), vertices.reshape(*topology.shape, 3), topology, side=cloth_side, unit="m")
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
    scale = cloth_side / CLOTH_LENGTH
    mesh, centre = centred((vertices / scale).astype(np.float32).reshape(*topology.shape, 3))
    return MeshState(mesh, centre, scale)


def _on_table(vertices: Float[np.ndarray, "vertices 3"], cloth_side: float) -> bool:
    return bool(abs(vertices[:, 2].min()) <= _OFF_TABLE * cloth_side)


def check_grid(
    name: str, mesh: Float[np.ndarray, "u v 3"], topology: Topology = SQUARE, *, side: float, unit: str
) -> None:
    """Raises InputError when a grid, folded or not, is not as wide along its edges as a cloth of `side` [`unit`].

    `side` is the longer side of a cloth that is no square.
    """
    along_u, along_v = (
        width * (CLOTH_LENGTH / length) for width, length in zip(widths(mesh), topology.sides, strict=True)
    )
    found = (along_u + along_v) / 2
    if not _NARROWEST <= found / side <= _WIDEST:
        raise InputError(
            f"{name}: the mesh's side is {found:.3g} along its edges, expected the cloth's, {side:g} {unit}"
        )
    if min(along_u, along_v) * _WIDEST < max(along_u, along_v) * _NARROWEST:
        measured = " x ".join(f"{width:.3g}" for width in widths(mesh))
        expected = " x ".join(f"{side * length / CLOTH_LENGTH:.3g}" for length in topology.sides)
        raise InputError(f"{name}: the mesh's sides are {measured} along its edges, expected {expected} {unit}")
    check_span(name, mesh.reshape(-1, 3), side=side, unit=unit)


def check_span(
    name: str, vertices: Float[np.ndarray, "vertices 3"], *, side: float, unit: str, meshed: bool = False
) -> None:
    """Raises InputError when vertices span more than the cloth's diagonal along an axis.

    `meshed` states that the vertices may be a camera's points; the message then mentions --as-points.
    """
    span = float(np.ptp(vertices.astype(float), axis=0).max())
    if span > _MOST_SPAN * side:
        other = ", or give --as-points if its vertices are what a camera measured" if meshed else ""
        raise InputError(f"{name}: spans {span:.3g}, expected a cloth of side {side:g} {unit}; check its unit{other}")


def from_above(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], *, pitch: float
) -> PointCloud:
    """The points of a surface that are visible from straight above, sampled `pitch` [m] apart; the table is z = 0."""
    low, span = vertices[:, :2].min(0), np.ptp(vertices[:, :2], axis=0)
    rows, columns = (int(n) for n in np.ceil(span / pitch) + 1)
    # Rows of the raster run along x.
    places = (vertices[:, 1::-1] - low[::-1]) / pitch
    heights, owner = topmost(places[faces], vertices[:, 2][faces], (rows, columns))
    row, column = np.nonzero(owner >= 0)
    points = np.stack([*(low[:, None] + (np.stack([row, column]) + 0.5) * pitch), heights[row, column]], axis=-1)
    return PointCloud(points, table=LEVEL, surface=True)

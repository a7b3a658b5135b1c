"""Reads all triangles of an OBJ, PLY or GLB file as one mesh, and checks that its parts share vertices."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Float, Int, UInt8
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from trimesh.visual import ColorVisuals

from clothkit.observation.glb import load_glb
from clothkit.observation.grids import welded
from clothkit.observation.obj import load_obj
from clothkit.observation.ply import load_ply
from clothkit.observation.states import named
from clothkit.runtime.errors import InputError

_MOST_VERTICES = 20_000_000
"""Largest number of vertices in all objects of a scene, which can contain one mesh many times."""


class Loaded(NamedTuple):
    """The content of a file, in its own frame and unit."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    """Empty if the file holds points."""
    colours: UInt8[np.ndarray, "vertices 3"] | None
    """Colours of the vertices; None unless all parts have them."""
    names: tuple[str, ...]
    """Names of the parts."""
    part: Int[np.ndarray, " faces"]
    """The index in `names` of the part that each triangle belongs to."""


def load(path: Path, content: bytes) -> Loaded:
    """The parts of a file that have triangles, or all parts if none has any.

    Raises InputError when the file can't be read, holds no vertices, or a triangle refers to vertices that don't exist.
    """
    try:
        parts = _parts(path, content)
        some = {name: part for name, part in parts.items() if len(getattr(part, "faces", ()))} or parts
        vertices = [np.asarray(part.vertices, float).reshape(-1, 3) for part in some.values()]
        faces = [np.asarray(getattr(part, "faces", np.zeros((0, 3))), int).reshape(-1, 3) for part in some.values()]
        colours = [_colours(part) for part in some.values()]
    except InputError:
        raise
    except Exception as error:  # the readers raise many kinds of errors: KeyError, IndexError, struct.error, ...
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: can't be read as {path.suffix[1:].upper()} ({reason})") from error
    if not sum(map(len, vertices)):
        raise InputError(f"{path}: holds no vertices; if a camera took it, its view is empty")
    for points, triangles in zip(vertices, faces, strict=True):
        if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(points)):
            raise InputError(f"{path}: has triangles between vertices that it doesn't hold, there are {len(points)}")
    known = [each for each in colours if each is not None]
    first = np.cumsum([0, *map(len, vertices[:-1])])
    return Loaded(
        np.concatenate(vertices),
        np.concatenate([triangles + start for triangles, start in zip(faces, first, strict=True)]),
        np.concatenate(known) if len(known) == len(colours) else None,
        tuple(some),
        np.repeat(np.arange(len(faces)), [len(triangles) for triangles in faces]),
    )


def check_joined(path: Path, loaded: Loaded, *, tolerance: float) -> None:
    """Raises InputError that names the parts unless shared vertices connect all of them to one surface.

    Vertices within `tolerance` of one another count as shared.
    """
    count = len(loaded.names)
    if count == 1:
        return
    place = welded(loaded.vertices, tolerance)
    # The nodes of the graph are parts and vertices; each triangle connects its part to its vertices.
    edges = np.repeat(loaded.part, 3), count + place[loaded.faces].ravel()
    size = count + len(place)
    graph = coo_matrix((np.ones(len(edges[0]), bool), edges), shape=(size, size))
    piece = connected_components(graph, directed=False)[1][:count]
    apart = len(np.unique(piece))
    if apart > 1:
        raise InputError(
            f"{path}: holds {apart} objects that share no vertices (among {named(loaded.names)}), expected one cloth; "
            "leave the others out"
        )


def _parts(path: Path, content: bytes) -> dict[str, trimesh.Trimesh | trimesh.PointCloud]:
    ending = path.suffix.lower()
    if ending != ".glb":
        found = (load_ply if ending == ".ply" else load_obj)(path, content)
        return {} if found is None else {path.stem: found}
    scene = load_glb(path, content)
    parts = {}
    place = {name: k for k, name in enumerate(scene.geometry)}
    # trimesh lists nodes in any order, but the order of a grid's vertices depends on it.
    nodes = sorted(scene.graph.nodes_geometry, key=lambda node: (place[scene.graph[node][1]], str(node)))
    count = sum(len(getattr(scene.geometry[scene.graph[node][1]], "vertices", ())) for node in nodes)
    if count > _MOST_VERTICES:
        raise InputError(f"{path}: holds {len(nodes)} objects of {count} vertices in all, expected one cloth")
    for node in nodes:
        transform, name = scene.graph[node]
        part = scene.geometry[name].copy()
        if isinstance(part, trimesh.Trimesh | trimesh.PointCloud):
            parts[str(node)] = part.apply_transform(transform)
    return parts


def _colours(part: trimesh.Trimesh | trimesh.PointCloud) -> np.ndarray | None:
    if isinstance(part, trimesh.PointCloud):
        colours = np.asarray(part.colors)
    elif isinstance(part.visual, ColorVisuals) and part.visual.kind == "vertex":
        colours = np.asarray(part.visual.vertex_colors)
    else:
        return None
    return colours[:, :3].astype(np.uint8) if colours.shape == (len(part.vertices), 4) else None

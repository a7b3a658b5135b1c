"""Reads OBJ files as one mesh: keeps positions and polygons, and leaves out what trimesh splits a mesh by."""

import io
from pathlib import Path

import trimesh

from clothkit.runtime.errors import InputError


def load_obj(path: Path, content: bytes) -> trimesh.Trimesh | trimesh.PointCloud | None:
    """The mesh, or the points, in an OBJ file, read by trimesh; None if it holds no vertices.

    Groups, objects, materials, texture coordinates and normals are left out, because trimesh splits a mesh by them.
    Raises InputError when a face is malformed or refers to vertices that don't exist. Other errors are trimesh's.
    """
    text, count = _positions(path, content.decode("utf-8", "replace"))
    if not count:
        return None
    found = trimesh.load(io.BytesIO(text.encode()), file_type="obj", process=False, skip_materials=True)
    assert isinstance(found, trimesh.Trimesh | trimesh.PointCloud)
    return found


def _positions(path: Path, text: str) -> tuple[str, int]:
    """The file's lines v and f alone, faces with vertex numbers from 1, and the number of vertices.

    Negative numbers count back from the last vertex above their line; trimesh would count them back from the file's
    last vertex.
    """
    vertices, faces, highest, where = [], [], 0, 0
    for number, line in enumerate(text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines(), start=1):
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append(" ".join(["v", *words]))
        elif kind == "f":
            try:
                corners = [int(word.split("/", 1)[0]) for word in words]
                if len(corners) < 3 or 0 in corners:
                    raise ValueError
            except ValueError as error:
                raise InputError(f"{path}: line {number} is no face: {line[:60]!r}") from error
            corners = [corner if corner > 0 else len(vertices) + 1 + corner for corner in corners]
            if min(corners) < 1:
                raise InputError(f"{path}: line {number} is a face of vertices that are not there: {line[:60]!r}")
            if max(corners) > highest:
                highest, where = max(corners), number
            faces.append(" ".join(["f", *map(str, corners)]))
    if highest > len(vertices):
        raise InputError(f"{path}: line {where} is a face of vertex {highest}, there are {len(vertices)}")
    return "\n".join([*vertices, *faces]), len(vertices)

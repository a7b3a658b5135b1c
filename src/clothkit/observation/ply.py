"""What PLY files say that their readers don't mind: counts that the file can't hold, and other names of colours."""

import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import plyfile
import trimesh
from trimesh.geometry import triangulate_quads

from clothkit.errors import InputError

_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16", "float16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}
_END = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r)", re.MULTILINE)
# MeshLab, VTK and others; the first of a row is what trimesh knows.
_COLOURS = (("red", "diffuse_red", "r"), ("green", "diffuse_green", "g"), ("blue", "diffuse_blue", "b"))
_FACES = ("vertex_indices", "vertex_index")


class Element(NamedTuple):
    """A table of a PLY file."""

    name: str
    rows: int
    size: int
    """Bytes that a row takes at least."""
    properties: tuple[str, ...]


def load_ply(path: Path, content: bytes) -> trimesh.Trimesh | trimesh.PointCloud | None:
    """The mesh, or the points, in a PLY file; None if it holds no vertices.

    By trimesh, and by plyfile where trimesh can't: polygons of several sizes in binary files, lists beside faces.
    Raises InputError when the header is none, promises more than the file holds, or has triangle strips; else what the
    readers raise.
    """
    end = _END.search(content)
    if not content.startswith(b"ply") or not end:
        raise InputError(f"{path}: can't be read as PLY, its header is none or does not end")
    header = content[: end.end()]
    elements = _elements(path, header.decode("ascii", "replace"))
    for element in elements:
        if element.rows * element.size > len(content) - end.end():
            raise InputError(
                f"{path}: its header says {element.rows} rows of {element.name}, more than the file's {len(content)} "
                "bytes hold"
            )
    by_name = {element.name: element for element in elements}
    if "vertex" not in by_name or not by_name["vertex"].rows:
        return None
    if "tristrips" in by_name:
        raise InputError(f"{path}: holds triangle strips, expected faces; save it as triangles")
    content = _renamed(header, by_name["vertex"].properties) + content[end.end() :]
    try:
        found = trimesh.load(io.BytesIO(content), file_type="ply", process=False, skip_materials=True)
    except Exception:  # trimesh's reader raises what it likes; plyfile tells what is wrong
        found = None
    if isinstance(found, trimesh.Trimesh | trimesh.PointCloud):
        return found
    return _by_plyfile(content)


def _elements(path: Path, header: str) -> list[Element]:
    text = "ascii" in header.split("element")[0]
    elements: list[Element] = []
    for line in header.splitlines():
        words = line.split()
        try:
            if words[:1] == ["element"]:
                name, rows = words[1:]
                if int(rows) < 0:
                    raise ValueError
                # A row of no properties still takes a line of text; in binary files it is refused below.
                elements.append(Element(name, int(rows), int(text), ()))
            elif words[:1] == ["property"]:
                size, last = _SIZES[words[2] if words[1] == "list" else words[1]], elements[-1]
                elements[-1] = last._replace(
                    size=last.size + (2 if text else size), properties=(*last.properties, words[-1])
                )
        except (ValueError, IndexError, KeyError) as error:
            raise InputError(f"{path}: can't be read as PLY, its header has the line {line[:60]!r}") from error
    for element in elements:
        if element.rows and not element.properties:
            raise InputError(f"{path}: can't be read as PLY, {element.name} of its header has no properties")
    return elements


def _renamed(header: bytes, properties: tuple[str, ...]) -> bytes:
    """The header with the names of colours that trimesh knows."""
    for known, *others in _COLOURS:
        other = next((name for name in others if name in properties), None)
        if known not in properties and other:
            line = re.compile(rb"^(property\s+\w+\s+)%b(\s*)$" % other.encode(), re.MULTILINE)
            header = line.sub(rb"\1%b\2" % known.encode(), header)
    return header


def _by_plyfile(content: bytes) -> trimesh.Trimesh | trimesh.PointCloud:
    data = plyfile.PlyData.read(io.BytesIO(content))
    vertex = data["vertex"]
    vertices = np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=-1)
    names = [property_.name for property_ in vertex.properties]
    colours = None
    if all(known in names for known, *_ in _COLOURS):
        colours = np.stack([vertex[known] for known, *_ in _COLOURS], axis=-1)
    polygons: list[np.ndarray] = []
    if "face" in data:
        name = next(p.name for p in data["face"].properties if p.name in _FACES)
        polygons = [polygon for polygon in data["face"][name] if len(polygon) > 2]
    if not polygons:
        return trimesh.PointCloud(vertices, colors=colours)
    return trimesh.Trimesh(vertices, triangulate_quads(polygons), vertex_colors=colours, process=False)

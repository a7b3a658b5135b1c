"""Reads PLY files by trimesh or plyfile, after checks of the header's counts, and with other names of colours."""

import io
import re
import tempfile
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import plyfile
import trimesh
from trimesh.geometry import triangulate_quads

from clothkit.errors import InputError
from clothkit.observation.colours import as_bytes, colours_of
from clothkit.observation.text import numbers, short

_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16", "float16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}
_END = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r)", re.MULTILINE)
# Names that MeshLab, VTK and others write; trimesh knows the first name of each row.
_COLOURS = (("red", "diffuse_red", "r"), ("green", "diffuse_green", "g"), ("blue", "diffuse_blue", "b"))
_FACES = ("vertex_indices", "vertex_index")


class Element(NamedTuple):
    """An element in a PLY file's header, which is a table of the file."""

    name: str
    rows: int
    size: int
    """Least number of bytes of a row."""
    properties: tuple[str, ...]
    whole: frozenset[str]
    """Names of the properties that are integers."""


_NONE = Element("", 0, 0, (), frozenset())


def load_ply(path: Path, content: bytes) -> trimesh.Trimesh | trimesh.PointCloud | None:
    """The mesh, or the points, in a PLY file; None if it holds no vertices.

    Text with polygons is read by trimesh, because plyfile reads text slowly. Binary files are read by plyfile, because
    trimesh assumes that all their polygons have the size of the first one. Raises InputError when the header is
    invalid, states more rows than the file holds, or has triangle strips. Other errors are those of the readers.
    """
    end = _END.search(content)
    if not content.startswith(b"ply") or not end:
        raise InputError(f"{path}: can't be read as PLY, its header is none or does not end")
    header = content[: end.end()]
    text = bool(re.search(rb"^format\s+ascii", header, re.MULTILINE))
    elements = _elements(path, header.decode("ascii", "replace"), text=text)
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
    rest = content[end.end() :]
    header = _cut(_renamed(header, by_name["vertex"].properties))
    if text and elements[0].name == "vertex" and not by_name.get("face", _NONE).rows:
        return _cloud(path, rest, elements[0])
    if text:
        found = trimesh.load(io.BytesIO(header + rest), file_type="ply", process=False, skip_materials=True)
        if isinstance(found, trimesh.Trimesh | trimesh.PointCloud):
            return found
        raise InputError(f"{path}: can't be read as PLY, it holds neither a mesh nor points")
    # plyfile maps tables into memory, for which it needs a file of the operating system.
    with tempfile.TemporaryFile() as file:
        file.write(header)
        file.write(rest)
        return _by_plyfile(file, by_name)


def _elements(path: Path, header: str, *, text: bool) -> list[Element]:
    elements: list[Element] = []
    for line in header.splitlines():
        words = line.split()
        try:
            if words[:1] == ["element"]:
                name, rows = words[1:]
                if int(rows) < 0:
                    raise ValueError
                elements.append(Element(name, int(rows), 0, (), frozenset()))
            elif words[:1] == ["property"]:
                size, last = _SIZES[words[2] if words[1] == "list" else words[1]], elements[-1]
                whole = last.whole if words[1].startswith(("float", "double")) else last.whole | {words[-1]}
                names = (*last.properties, words[-1])
                elements[-1] = last._replace(size=last.size + (2 if text else size), properties=names, whole=whole)
        except (ValueError, IndexError, KeyError) as error:
            raise InputError(f"{path}: can't be read as PLY, its header has the line {line[:60]!r}") from error
    for element in elements:
        if element.rows and not element.properties:
            raise InputError(f"{path}: can't be read as PLY, {element.name} of its header has no properties")
    return elements


def _renamed(header: bytes, properties: tuple[str, ...]) -> bytes:
    """The header with the properties for colours renamed to the names that trimesh knows."""
    for known, *others in _COLOURS:
        other = next((name for name in others if name in properties), None)
        if known not in properties and other:
            line = re.compile(rb"^(property\s+\w+\s+)%b(\s*)$" % other.encode(), re.MULTILINE)
            header = line.sub(rb"\1%b\2" % known.encode(), header)
    return header


def _cut(header: bytes) -> bytes:
    """The header up to the last element that is needed, so that later ones are not read."""
    tables = re.split(rb"^(?=element\s)", header, flags=re.MULTILINE)
    needed = [k for k, table in enumerate(tables) if re.match(rb"element\s+(vertex|face)\s", table)]
    end = _END.search(header)
    assert end is not None
    return b"".join(tables[: max(needed) + 1]) + (b"" if max(needed) + 1 == len(tables) else end[0])


def _cloud(path: Path, data: bytes, vertex: Element) -> trimesh.PointCloud:
    """The point cloud in a text file whose first element is the vertices."""
    lines = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n", vertex.rows)
    table = numbers(path, b"\n".join(lines[: vertex.rows]), width=len(vertex.properties))
    if len(table) < vertex.rows:
        raise short(path, len(table), vertex.rows)
    with np.errstate(invalid="ignore"):
        columns = {
            name: column.astype(np.int64) if name in vertex.whole else column
            for name, column in zip(vertex.properties, table.T, strict=True)
        }
    return trimesh.PointCloud(np.stack([columns[axis] for axis in "xyz"], axis=-1), colors=colours_of(columns))


def _by_plyfile(file: IO[bytes], elements: dict[str, Element]) -> trimesh.Trimesh | trimesh.PointCloud:
    lists = [name for name in elements["face"].properties if name in _FACES] if "face" in elements else []
    data = None
    # If all polygons have one size, plyfile can read them as a table; it raises an error if they don't.
    for size in (3, 4) if lists else ():
        file.seek(0)
        try:
            data = plyfile.PlyData.read(file, known_list_len={"face": {lists[0]: size}})
            break
        except plyfile.PlyParseError:
            continue
    if data is None:
        file.seek(0)
        data = plyfile.PlyData.read(file)
    vertex = data["vertex"]
    vertices = np.stack([np.array(vertex[axis], float) for axis in "xyz"], axis=-1)
    colours = None
    if all(set(names) & set(elements["vertex"].properties) for names in _COLOURS):
        colours = as_bytes(np.stack([np.array(vertex[known]) for known, *_ in _COLOURS], axis=-1))
    polygons: Any = np.array(data["face"][lists[0]]) if lists else []
    if lists and polygons.dtype == object:
        polygons = [polygon for polygon in polygons if len(polygon) > 2]
    if not len(polygons):
        return trimesh.PointCloud(vertices, colors=colours)
    return trimesh.Trimesh(vertices, triangulate_quads(polygons), vertex_colors=colours, process=False)

"""Reads PLY files, binary ones by plyfile, after checks of the header's counts, and with other names of colours."""

import re
import tempfile
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import plyfile
import trimesh
from trimesh.geometry import triangulate_quads

from clothkit.observation.colours import as_bytes, colours_of
from clothkit.observation.text import numbers, short
from clothkit.runtime.errors import InputError

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
    lists: frozenset[str]
    """Names of the properties that are lists, which start with their length."""


def load_ply(path: Path, content: bytes) -> trimesh.Trimesh | trimesh.PointCloud | None:
    """The mesh, or the points, in a PLY file; None if it holds no vertices.

    Binary files are read by plyfile. Text is read here: plyfile reads it slowly, and trimesh accepts a file that is cut
    short. Raises InputError when the header is invalid, states more rows than the file holds, or has triangle strips,
    and when a row of text is not a row of numbers. Other errors are those of plyfile.
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
    if text:
        return _by_lines(path, rest, elements)
    header = _cut(_renamed(header, by_name["vertex"].properties))
    # plyfile maps tables into memory, for which it needs a true file.
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
                elements.append(Element(name, int(rows), 0, (), frozenset(), frozenset()))
            elif words[:1] == ["property"]:
                size, last = _SIZES[words[2] if words[1] == "list" else words[1]], elements[-1]
                whole = last.whole if words[1].startswith(("float", "double")) else last.whole | {words[-1]}
                names = (*last.properties, words[-1])
                lists = last.lists | {words[-1]} if words[1] == "list" else last.lists
                elements[-1] = last._replace(
                    size=last.size + (2 if text else size), properties=names, whole=whole, lists=lists
                )
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


def _by_lines(path: Path, data: bytes, elements: list[Element]) -> trimesh.Trimesh | trimesh.PointCloud:
    """The mesh or points in a text file, in which each line that is not blank is a row of a table."""
    rest = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").lstrip(b"\n")
    tables: dict[str, tuple[Element, list[bytes]]] = {}
    for element in elements:
        *rows, rest = (*rest.split(b"\n", element.rows), b"")[: element.rows + 1]
        rows = [row for row in rows if row.strip()]
        while len(rows) < element.rows and rest:
            row, _, rest = rest.partition(b"\n")
            rows += [row] if row.strip() else []
        if len(rows) < element.rows and element.name == "vertex":
            raise short(path, len(rows), element.rows)
        if len(rows) < element.rows and element.name == "face":
            raise InputError(f"{path}: ends after {len(rows)} faces, its header says {element.rows}")
        tables[element.name] = element, rows
    vertex, rows = tables["vertex"]
    table = numbers(path, b"\n".join(rows), width=len(vertex.properties))
    with np.errstate(invalid="ignore"):
        columns = {
            name: column.astype(np.int64) if name in vertex.whole else column
            for name, column in zip(vertex.properties, table.T, strict=True)
        }
    vertices, colours = np.stack([columns[axis] for axis in "xyz"], axis=-1), colours_of(columns)
    polygons = _polygons(path, *tables["face"]) if "face" in tables else []
    if not len(polygons):
        return trimesh.PointCloud(vertices, colors=colours)
    return trimesh.Trimesh(vertices, triangulate_quads(polygons), vertex_colors=colours, process=False)


def _polygons(path: Path, face: Element, rows: list[bytes]) -> Any:
    """The vertices of each face [faces corners], or lists of them where they differ in number."""
    wanted = next((name for name in face.properties if name in _FACES and name in face.lists), None)
    if wanted is None or not rows:
        return []
    found: list[list[int]] = []
    for place, row in enumerate(rows):
        try:
            found.append(_list_of(face, wanted, row.split()))
        except ValueError as error:
            raise InputError(
                f"{path}: face {place} is {row.decode('latin-1')[:60]!r}, expected {_row(face)}"
            ) from error
    polygons = [polygon for polygon in found if len(polygon) > 2]
    return np.array(polygons) if len({len(polygon) for polygon in polygons}) == 1 else polygons


def _list_of(element: Element, wanted: str, words: list[bytes]) -> list[int]:
    """The numbers of one of a row's lists. Raises ValueError when the row has more or fewer words than it says."""
    place, found = 0, []
    for name in element.properties:
        count = int(words[place]) if name in element.lists and place < len(words) else 0
        if name == wanted:
            found = [int(word) for word in words[place + 1 : place + 1 + count]]
        place += 1 + count
    if place != len(words):
        raise ValueError(f"expected {place} words, found {len(words)}")
    return found


def _row(element: Element) -> str:
    names = (f"a count and so many {name}" if name in element.lists else name for name in element.properties)
    return ", ".join(names)


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

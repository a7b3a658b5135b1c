"""Reader of ARCSim's OBJ dialect: one cloth at one moment, with any triangulation.

The file has `vt u v` (material coordinates in metres), per node `v x y z` and optionally `nv` (velocity), and faces
`f n/vt n/vt n/vt`. Everything else (rest embedding, labels, edges, plasticity) is ignored.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from clothkit.runtime.errors import InputError, system_error

SQUARE = 0.01
"""Largest difference between the sides of the material, as a fraction of the longer one."""

UNCOVERED = 1e-4
"""Largest fraction of the material square outside all triangles; it is not 0, as coordinates have six digits."""

_NUMBERS = {"v": ("v x y z", 3), "nv": ("nv x y z", 3), "vt": ("vt u v", 2)}
_FACE = "f n/vt n/vt n/vt"


class Frame(NamedTuple):
    """A cloth at one moment, with one vertex per node; ARCSim's remeshing gives every frame its own nodes."""

    positions: Float[np.ndarray, "vertices 3"]
    """Metres, world frame."""
    material: Float[np.ndarray, "vertices 2"]
    """Metres."""
    triangles: Int[np.ndarray, "triangles 3"]
    speed: Float[np.ndarray, " vertices"] | None
    """m/s; None where the file holds no velocities, as before the first step."""

    @property
    def side(self) -> float:
        """The side of the material square, in metres."""
        return float(np.ptp(self.material, axis=0).mean())

    def geodesic(self, vertex: int) -> Float[np.ndarray, "2"]:
        """Return a vertex's geodesic coordinates, -1..1 from the material square's lowest to its highest corner."""
        low, high = self.material.min(0), self.material.max(0)
        return (self.material[vertex] - low) / (high - low) * 2 - 1


def read_frame(path: Path) -> Frame:
    """Read the cloth in an OBJ file.

    Raises InputError, with the line number if there is one, for a file that can't be read, for a cloth with seams, and
    for a material that is not square or not covered by the triangles.
    """
    numbers, corners = _parse(path)
    positions, texture = numbers["v"], numbers["vt"]
    if not len(positions) or not len(corners):
        raise InputError(f"{path}: holds {len(positions)} vertices and {len(corners)} faces, expected a cloth")
    for column, (name, most) in enumerate((("v", len(positions)), ("vt", len(texture)))):
        outside = (corners[..., column] < 0) | (corners[..., column] >= most)
        if outside.any():
            wrong = corners[..., column][outside][0] + 1
            raise InputError(f"{path}: a face refers to {name} number {wrong}, the file holds {most}; is it cut short?")
    node, vt = corners[..., 0], corners[..., 1]
    of_node = np.full(len(positions), -1)
    of_node[node.ravel()] = vt.ravel()
    if (of_node < 0).any():
        raise InputError(f"{path}: node {np.flatnonzero(of_node < 0)[0] + 1} belongs to no face")
    material = texture[of_node]
    seam = (texture[vt] != material[node]).any(-1)
    if seam.any():
        first = node[seam][0]
        raise InputError(
            f"{path}: node {first + 1} has several material coordinates, so the cloth has seams; expected one piece"
        )
    speed = np.linalg.norm(numbers["nv"], axis=-1) if len(numbers["nv"]) == len(positions) else None
    frame = Frame(positions, material, node.astype(np.int32), speed)
    _check_square(path, frame)
    return frame


def _parse(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the numbers by keyword, and the indices (node, vt) of every face's corners, from 0, int [faces 3 2]."""
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except OSError as error:
        raise system_error(error, path, expected="an OBJ file of ARCSim") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: can't be read as an OBJ file ({error})") from error
    found: dict[str, list[list[float]]] = {"v": [], "nv": [], "vt": []}
    corners: list[list[list[int]]] = []
    for number, line in enumerate(lines, 1):
        kind, *fields = line.split() or [""]
        if kind not in found and kind != "f":
            continue
        form, width = _NUMBERS.get(kind, (_FACE, 3))
        try:
            if kind == "f":
                corners.append([[int(index) - 1 for index in field.split("/")[:2]] for field in fields])
                right = len(fields) == 3 and all(len(corner) == 2 for corner in corners[-1])
            else:
                found[kind].append([float(field) for field in fields])
                right = len(fields) == width and bool(np.isfinite(found[kind][-1]).all())
        except ValueError:
            right = False
        if not right:
            raise InputError(f"{path}: line {number}: expected {form!r}, found {line.strip()[:60]!r}")
    numbers = {kind: np.array(rows, float).reshape(-1, _NUMBERS[kind][1]) for kind, rows in found.items()}
    return numbers, np.array(corners, int).reshape(-1, 3, 2)


def _check_square(path: Path, frame: Frame) -> None:
    width, height = np.ptp(frame.material, axis=0)
    if not max(width, height) or abs(width - height) > SQUARE * max(width, height):
        raise InputError(f"{path}: its material coordinates span {width:g} x {height:g} m, expected a square")
    a, b, c = (frame.material[frame.triangles[:, k]] for k in range(3))
    (bu, bv), (cu, cv) = (b - a).T, (c - a).T
    covered = np.abs(bu * cv - bv * cu).sum() / 2 / (width * height)
    if covered < 1 - UNCOVERED:
        raise InputError(f"{path}: its triangles cover {covered:.2%} of the material square, expected all of it")

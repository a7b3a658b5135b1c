"""Tables of PLY files as text: read whole, or told of in one sentence."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clothkit.observation.ply import load_ply
from clothkit.runtime.errors import InputError


def text_ply(*faces: str, says: int | None = None, listed: str = "list uchar int vertex_indices") -> bytes:
    """A square of 0.4 m; `says` is how many faces the header promises."""
    header = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {axis}" for axis in "xyz")]
    header += [f"element face {len(faces) if says is None else says}"]
    header += [f"property {one}" for one in listed.split("; ")]
    rows = ["0 0 0", "0.4 0 0", "0.4 0.4 0", "0 0.4 0"]
    return "\n".join([*header, "end_header", *rows, *faces, ""]).encode()


@pytest.mark.parametrize(
    ("content", "count"),
    [
        (text_ply("3 0 1 2", "3 0 2 3"), 2),
        (text_ply("3 0 1 2", "3 0 2 3").replace(b"\n", b"\r\n"), 2),
        (text_ply("4 0 1 2 3"), 2),
        (text_ply("3 0 1 2", "", "4 0 1 2 3", says=2), 3),
        (text_ply("3 0 1 2", "2 0 1"), 1),
        (text_ply("7 3 0 1 2", "8 3 0 2 3", listed="uchar kind; list uchar int vertex_index"), 2),
        (text_ply("3 0 1 2 2 0 1", listed="list uchar int vertex_indices; list uchar float uv"), 1),
    ],
)
def test_faces_of_text(tmp_path: Path, content: bytes, count: int) -> None:
    found = load_ply(tmp_path / "a.ply", content)
    assert isinstance(found, trimesh.Trimesh)
    assert found.vertices.shape == (4, 3)
    assert found.faces.shape == (count, 3)
    np.testing.assert_array_equal(found.faces[0], [0, 1, 2])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (text_ply("3 0 1 2", says=2), "ends after 1 faces, its header says 2"),
        (text_ply("3 0 1 2", "3 0 2"), "face 1 is '3 0 2', expected a count and so many vertex_indices"),
        (text_ply("3 0 1 2", "noise"), "face 1 is 'noise'"),
        (text_ply("3 0 1 2", "3 0 1.5 2"), "face 1 is '3 0 1.5 2'"),
        (text_ply("3 0 1 2", "-1"), "face 1 is '-1'"),
        (text_ply("3 0 1 2 3"), "face 0 is '3 0 1 2 3'"),
        (text_ply("3 0 1 2").replace(b"0.4 0.4 0", b"0.4 nothing 0"), "point 2 is '0.4 nothing 0', expected 3 numbers"),
        (text_ply("3 0 1 2").replace(b"\n0.4 0.4 0\n", b"\n0.4 0.4\n"), "expected 3 numbers"),
    ],
)
def test_text_that_is_cut_short_or_no_row_is_told(tmp_path: Path, content: bytes, says: str) -> None:
    with pytest.raises(InputError, match=re.escape(says)):
        load_ply(tmp_path / "a.ply", content)


def test_points_between_other_tables_of_text(tmp_path: Path) -> None:
    content = b"ply\nformat ascii 1.0\nelement camera 1\nproperty float view\nelement vertex 2\nproperty float x\n"
    content += b"property float y\nproperty float z\nelement range_grid 2\nproperty list uchar int vertex_indices\n"
    content += b"end_header\n1.5\n\n0 1 2\n3 4 5\n1 0\n1 1\n"
    found = load_ply(tmp_path / "a.ply", content)
    assert isinstance(found, trimesh.PointCloud)
    np.testing.assert_array_equal(found.vertices, [[0, 1, 2], [3, 4, 5]])

"""PCD files of every kind hold the points that were written, and headers are not believed."""

import resource
import struct
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.observation.pcd import read_pcd
from clothkit.runtime.errors import InputError
from tests.observation.pcds import packed, written, written_pcd

RANDOM = np.random.default_rng(0)
POINTS = RANDOM.normal(size=(40, 3)).astype(np.float32)
COLOURS = RANDOM.integers(0, 256, (40, 3))
X, Y, Z = POINTS.T
FLOATS = packed(COLOURS)
WHOLE = FLOATS.view(np.uint32)
APART = dict(zip("rgb", COLOURS.astype(np.uint8).T, strict=True))
DATA = ("ascii", "binary", "binary_compressed")
XYZ = {"x": X, "y": Y, "z": Z}


def alike(path: Path, *, colours: bool = True) -> None:
    cloud = read_pcd(path)
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
    if colours:
        np.testing.assert_array_equal(cloud.colours, COLOURS)
    else:
        assert cloud.colours is None


@pytest.mark.parametrize("data", DATA)
@pytest.mark.parametrize(
    "columns",
    [
        {**XYZ, "rgb": FLOATS},
        {**XYZ, "rgba": WHOLE | np.uint32(0xFF000000)},
        {**XYZ, "rgb": (WHOLE | np.uint32(0xFF000000)).view(np.int32)},
        {**XYZ, **APART},
        {**XYZ, "r": COLOURS[:, 0] / 255, "g": COLOURS[:, 1] / 255, "b": COLOURS[:, 2] / 255},
        {"normal_x": X * 0, "_": np.zeros((40, 12), np.uint8), "rgb": FLOATS, **XYZ, "ring": np.ones(40, np.uint16)},
        {"x": X.astype(float), "y": Y.astype(float), "z": Z.astype(float), "rgb": WHOLE},
    ],
    ids=["float", "rgba", "int", "apart", "shares", "padded", "double"],
)
def test_every_layout_in_every_encoding(tmp_path: Path, columns: Mapping[str, np.ndarray], data: str) -> None:
    alike(written(tmp_path / "cloud.pcd", columns, data))


@pytest.mark.parametrize("data", DATA)
@pytest.mark.parametrize(
    "header",
    [{"POINTS": ""}, {"COUNT": "", "VIEWPOINT": ""}, {"WIDTH": "8", "HEIGHT": "5"}, {"WIDTH": "", "HEIGHT": ""}],
    ids=str,
)
def test_what_a_header_need_not_say(tmp_path: Path, data: str, header: Mapping[str, str]) -> None:
    alike(written(tmp_path / "cloud.pcd", {**XYZ, "rgb": FLOATS}, data, header=header))


def test_other_writers(tmp_path: Path) -> None:
    columns = {**XYZ, "rgb": FLOATS}
    alike(written(tmp_path / "literal.pcd", columns, "binary_compressed", literally=True))
    alike(written(tmp_path / "windows.pcd", columns, "ascii", newline="\r\n"))
    older = written(tmp_path / "older.pcd", columns, "binary", header={"VERSION": ".5"})
    older.write_bytes(older.read_bytes().replace(b"FIELDS", b"COLUMNS", 1))
    alike(older)
    # As text a packed colour may be the number that its bits are.
    alike(written(tmp_path / "whole.pcd", {**XYZ, "rgb": WHOLE}, "ascii", header={"TYPE": "F F F F"}))
    alike(written(tmp_path / "bare.pcd", XYZ, "binary"), colours=False)


def test_viewpoint_and_points_that_are_not_measured(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[3] = np.nan
    for data in DATA:
        cloud = read_pcd(written_pcd(tmp_path / "cloud.pcd", points, data))
        np.testing.assert_allclose(cloud.points, points, atol=1e-6)
        np.testing.assert_allclose(cloud.viewpoint, [0.1, 0.2, 0.9])
        np.testing.assert_array_equal(cloud.colours, np.tile([10, 200, 30], (40, 1)))


def bad(data: str = "ascii", cut: int | None = None, **header: str) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        written_pcd(path, np.ones((3, 3)), data, header=header)
        path.write_bytes(path.read_bytes()[:cut])

    return make


def plain(text: bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(text) and None


HEAD = b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 2\nDATA "
FULL = {"WIDTH": "9", "POINTS": "9"}


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (plain(b"VERSION .7\nFIELDS x y z\n"), "is no PCD file, its header has no line DATA"),
        (bad(SIZE=""), "is no PCD file, its header has no line SIZE"),
        (bad(FIELDS="x y w _ rgb"), "has no field z, its fields are x y w _ rgb"),
        (bad(FIELDS="x y z x rgb", COUNT="1 1 1 1 1"), "has field x 2 times, expected it once"),
        (bad(FIELDS="x y z rgb rgb"), "has field rgb 2 times, expected it once"),
        (bad(COUNT="1 1"), "FIELDS, SIZE, TYPE and COUNT of its header differ in length"),
        (bad(COUNT="1 1 1 -1 1"), "field _ has type U, size 1, count -1: unknown"),
        (bad(COUNT="1 1 1 0 1"), "field _ has type U, size 1, count 0: unknown"),
        (bad(COUNT="1 1 2 4 1"), "field z has type F, size 4, count 2: unknown"),
        (bad(COUNT="1 1 1 1000000000000 1"), "by its header a point takes 2000000000008 bytes, the file has"),
        (bad("binary", COUNT="1 1 1 1000000000000 1"), "by its header a point takes 1000000000016 bytes"),
        (bad(TYPE="F F Q U F"), "field z has type Q, size 4, count 1: unknown"),
        (bad(SIZE="4 4 3 1 4"), "field z has type F, size 3, count 1: unknown"),
        (bad(POINTS="many"), "POINTS is 'many' in its header, expected a whole number"),
        (bad(POINTS="-3"), "POINTS is '-3' in its header, expected a whole number"),
        (bad(WIDTH="3.0"), "WIDTH is '3.0' in its header, expected a whole number"),
        (bad(POINTS="", WIDTH=""), "has neither POINTS nor WIDTH"),
        (bad(POINTS="2"), "POINTS is 2 in its header, but WIDTH times HEIGHT is 3"),
        (bad(POINTS="0", WIDTH="0"), "holds no points, its view is empty"),
        (bad(POINTS="2", WIDTH="2"), "goes on after the 2 points that its header says"),
        (bad(**FULL), "ends after 3 points, its header says 9"),
        (bad("binary", **FULL), "ends after 3 points, its header says 9"),
        (bad("binary", POINTS="1" + "0" * 15, WIDTH=""), "ends after 3 points, its header says 1000000000000000"),
        (bad("binary_compressed", **FULL), "its data unpack to 60 bytes, but 9 points take 180"),
        (bad("binary_compressed", cut=-9), "ends too early, or is broken"),
        (plain(HEAD + b"binary_compressed\n" + struct.pack("<II", 1, 24) + b"\xff"), "compressed data are broken"),
        (plain(HEAD + b"binary_compressed\n"), "ends after 0 points, its header says 2"),
        (plain(HEAD + b"ascii\n\n \n"), "ends after 0 points, its header says 2"),
        (plain(HEAD + b"ascii\n1 2 3\n"), "ends after 1 points, its header says 2"),
        (plain(HEAD + b"ascii\n1 2 3\n4 5\n"), "point 1 is '4 5', expected 3 numbers"),
        (plain(HEAD + b"ascii\n1 2 3\n\n4 5 six\n"), "point 1 is '4 5 six', expected 3 numbers"),
        (plain(HEAD + b"ascii\n1 2 3 4\n5 6 7 8\n"), "point 0 is '1 2 3 4', expected 3 numbers"),
        (plain(HEAD + b"base64\n"), "DATA is base64, expected ascii, binary, binary_compressed"),
        (bad(VIEWPOINT="here"), "VIEWPOINT is 'here'"),
    ],
)
def test_a_bad_file_is_one_sentence(tmp_path: Path, make: Callable[[Path], None], sentence: str) -> None:
    path = tmp_path / "bad.pcd"
    make(path)
    with pytest.raises(InputError, match=sentence) as raised:
        read_pcd(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(DATA), st.data())
def test_bytes_that_are_changed_are_told_or_read(
    tmp_path_factory: pytest.TempPathFactory, data: str, draw: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "changed.pcd"
    content = bytearray(written_pcd(path, POINTS, data).read_bytes())
    for _ in range(draw.draw(st.integers(1, 4))):
        content[draw.draw(st.integers(0, len(content) - 1))] = draw.draw(st.integers(0, 255))
    path.write_bytes(content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        told, count = "", len(read_pcd(path).points)
    except InputError as error:
        told, count = str(error), 0
    assert not told or (told.startswith(f"{path}: ") and "\n" not in told)
    assert count <= len(content)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000

"""NumPy's files: what is known by other names is taken, what is not is named, and headers are not believed."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.cloth.topology import SQUARE
from clothkit.observation.arrays import from_array, read_numpy
from clothkit.observation.camera import CameraConfig, render
from clothkit.observation.cloud import observe_cloud
from clothkit.observation.settings import CloudConfig
from clothkit.observation.states import MeshState, PointCloud, VoxelState
from clothkit.runtime.errors import InputError
from tests.observation.pcds import packed
from tests.observation.scenes import CLOTH, SCALE, folded

RANDOM = np.random.default_rng(0)
POINTS = RANDOM.normal(size=(70, 80, 3))
MASK = RANDOM.random((70, 80)) < 0.5
COLOURS = RANDOM.integers(0, 256, (70, 80, 3))


def saved(path: Path, **arrays: np.ndarray) -> PointCloud:
    np.savez(path, **arrays)
    state = read_numpy(path, cloth_side=CLOTH)
    assert isinstance(state, PointCloud)
    return state


def alike(cloud: PointCloud) -> None:
    np.testing.assert_allclose(cloud.points, POINTS.reshape(-1, 3), atol=1e-6)
    np.testing.assert_array_equal(cloud.cloth, MASK.ravel())
    np.testing.assert_array_equal(cloud.colours, COLOURS.reshape(-1, 3))


@pytest.mark.parametrize("image", [True, False], ids=["rows and columns", "list"])
@pytest.mark.parametrize("colours", [COLOURS, COLOURS.astype(np.uint8), COLOURS / 255, COLOURS.astype(float)])
@pytest.mark.parametrize("mask", [MASK, MASK.astype(int), MASK * np.uint8(255), MASK.astype(float)])
def test_masks_and_colours_of_all_kinds(tmp_path: Path, image: bool, colours: np.ndarray, mask: np.ndarray) -> None:
    shape = (70, 80) if image else (5600,)
    path = tmp_path / "a.npz"
    alike(saved(path, points=POINTS.reshape(*shape, 3), cloth=mask.reshape(shape), colours=colours.reshape(*shape, 3)))
    # A mask and colours of an image, and points in a list.
    alike(saved(path, points=POINTS.reshape(*shape, 3), cloth=mask.ravel(), colours=colours.reshape(-1, 3)))


@pytest.mark.parametrize(
    ("points", "mask", "colours"),
    [
        ("points", "mask", "colors"),
        ("xyz", "segmentation", "rgb"),
        ("PCD", "Cloth_Mask", "Colour"),
        ("pts", "seg", "rgb"),
    ],
)
def test_other_names(tmp_path: Path, points: str, mask: str, colours: str) -> None:
    cloud = saved(tmp_path / "a.npz", **{points: POINTS, mask: MASK, colours: COLOURS})
    alike(cloud)
    assert not cloud.unread
    assert not cloud.notices


def test_what_is_not_known_is_named_and_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    camera = np.array({"camera": "d435"}, dtype=object)
    cloud = saved(path, points=POINTS, cloth=MASK, colours=COLOURS, K=np.eye(3), meta=camera)
    alike(cloud)
    assert cloud.unread == ("K", "meta")
    assert cloud.notices == (
        f"{path}: K, meta are not read; of names beside the points, cloth, colours and viewpoint are known",
    )
    odd = saved(path, points=POINTS[:, :60] * 0.05, farben=COLOURS)
    wood = CloudConfig(table_colour=((0, 0, 0), (9, 9, 9)))
    with pytest.raises(InputError, match=r"has no colours, .* by them; its file has farben, expected colours, cloth"):
        observe_cloud(odd, cloth_side=CLOTH, settings=wood)
    with pytest.raises(
        InputError, match=r"nothing tells cloth and table apart.*; its file has farben, expected colours"
    ):
        observe_cloud(odd, cloth_side=CLOTH)


def test_a_table_of_points(tmp_path: Path) -> None:
    kinds = [("x", "<f4"), ("y", ">f4"), ("z", "<f8"), ("rgb", "<f4"), ("label", "U3")]
    table = np.zeros((70, 80), kinds)
    table["x"], table["y"], table["z"] = np.moveaxis(POINTS, -1, 0)
    table["rgb"] = packed(COLOURS.reshape(-1, 3)).reshape(70, 80)
    np.save(tmp_path / "a.npy", table)
    cloud = read_numpy(tmp_path / "a.npy", cloth_side=CLOTH)
    assert isinstance(cloud, PointCloud)
    np.testing.assert_allclose(cloud.points, POINTS.reshape(-1, 3), atol=1e-6)
    np.testing.assert_array_equal(cloud.colours, COLOURS.reshape(-1, 3))


@pytest.mark.parametrize("kind", [">f4", "<f2", "<f8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_byte_orders_do_not_matter(tmp_path: Path, kind: str, order: str) -> None:
    np.save(tmp_path / "mesh.npy", np.asarray(folded(), kind, order=order))  # type: ignore[call-overload]
    state = read_numpy(tmp_path / "mesh.npy", cloth_side=CLOTH)
    assert isinstance(state, MeshState)
    np.testing.assert_allclose(state.mesh, folded(), atol=2e-3)


def test_voxels_of_images(tmp_path: Path) -> None:
    seen = np.asarray(voxels.observe(folded()))
    for array in (seen, seen * np.uint8(255), seen.astype(float)):
        np.save(tmp_path / "a.npy", array)
        state = read_numpy(tmp_path / "a.npy", cloth_side=CLOTH)
        assert isinstance(state, VoxelState)
        np.testing.assert_array_equal(state.voxels, seen)


def headed(shape: str, *, kind: str = "<f8") -> bytes:
    """An NPY of 24 bytes whose header says another shape."""
    out = io.BytesIO()
    np.save(out, np.zeros(3))
    return out.getvalue().replace(b"(3,), ", f"{shape}, ".encode()).replace(b"<f8", kind.encode())


def pickled() -> bytes:
    out = io.BytesIO()
    np.save(out, np.array([{}], dtype=object), allow_pickle=True)
    return out.getvalue()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (headed("(1000000000000, 3)"), r"says that it is an array \[1000000000000, 3\], but has \d+ bytes"),
        (headed("(4, 3)"), r"says that it is an array \[4, 3\], but has"),
        (headed("(1, 3)", kind="<f3"), "is none or is broken"),
        (headed("(-1, 3)"), "is none or is broken"),
        (pickled(), "holds Python objects, expected numbers"),
    ],
)
@pytest.mark.parametrize("ending", ["npy", "npz"])
def test_headers_are_held_against_what_is_there(tmp_path: Path, content: bytes, sentence: str, ending: str) -> None:
    path = tmp_path / f"bad.{ending}"
    if ending == "npy":
        path.write_bytes(content)
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("points.npy", content)
    with pytest.raises(InputError, match=sentence) as raised:
        read_numpy(path, cloth_side=CLOTH)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({"K": POINTS, "D": MASK}, "has K, D; expected one of mesh, voxels, points, and beside points cloth"),
        ({"points": POINTS, "xyz": POINTS}, "holds points and xyz, of which only one can be the points"),
        ({"points": POINTS, "mesh": folded()}, "has points, mesh; expected one of mesh, voxels, points"),
        ({"points": POINTS, "mask": MASK * 2}, r"cloth has values other than 0 and 1 \(or 255\), expected a mask"),
        ({"points": POINTS, "mask": MASK[1:]}, r"cloth has shape \[69, 80\], expected \[70, 80\]"),
        ({"points": POINTS, "rgb": MASK}, r"colours has shape \[70, 80\], expected \[70, 80, 3\]"),
        ({"points": POINTS, "rgb": COLOURS * 257}, "colours are neither whole numbers 0 to 255 nor shares 0 to 1"),
        ({"points": POINTS, "viewpoint": np.eye(4)}, r"viewpoint has shape \[4, 4\], expected \[3\]"),
        ({"points": POINTS[0].T}, r"has shape \[3, 80\], .*; transpose it"),
        ({"points": np.zeros((9, 6))}, r"has shape \[9, 6\], .*; save the columns x, y, z alone"),
        ({"points": np.zeros((40, 41, 3))}, r"has shape \[40, 41, 3\], expected"),
        ({"points": np.zeros(9, [("x", "f4"), ("y", "f4")])}, "is a table of x, y, expected numbers x, y, z"),
    ],
)
def test_arrays_that_do_not_fit_get_one_sentence(tmp_path: Path, arrays: dict[str, np.ndarray], sentence: str) -> None:
    np.savez(tmp_path / "bad.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=sentence) as raised:
        read_numpy(tmp_path / "bad.npz", cloth_side=CLOTH)
    assert "\n" not in str(raised.value)


def test_many_names_are_cut(tmp_path: Path) -> None:
    arrays = {f"a{k}": np.zeros(1) for k in range(20)}
    cloud = saved(tmp_path / "a.npz", points=POINTS, **arrays)
    assert "a7, .. are not read" in cloud.notices[0]


def test_from_array_takes_what_it_is_given() -> None:
    cloud = from_array(POINTS, name="memory", cloth_side=CLOTH, cloth=MASK)
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.cloth, MASK.ravel())


CAMERA = CameraConfig(columns=160, rows=120, focal=147.5)
K = np.array([[147.5, 0, 79.5], [0, 147.5, 59.5], [0, 0, 1]])
"""The camera's matrix: its pixels' centres are half a pixel from their corners."""


def test_a_depth_image_is_the_points_that_its_camera_sees(tmp_path: Path) -> None:
    image = render(folded(angle=0.3).astype(float) * SCALE, SQUARE.triangles(), CAMERA)
    metres = image.depth.astype(np.float32)
    metres[0, 0] = np.nan
    by_ray = image.points().reshape(-1, 3)
    for name, depth, within in (
        ("depth", metres, 1e-6),
        ("Depth_Image", np.rint(1000 * image.depth).astype("u2"), 6e-4),
    ):
        cloud = saved(tmp_path / "a.npz", **{name: depth, "cloth": image.cloth, "K": K})
        np.testing.assert_allclose(cloud.points[1:], by_ray[1:], atol=within)
        np.testing.assert_array_equal(cloud.cloth, image.cloth.ravel())
        np.testing.assert_array_equal(cloud.viewpoint, np.zeros(3))
        assert not cloud.notices
    # Where points are there, too, nothing else is read.
    cloud = saved(tmp_path / "b.npz", points=POINTS, depth=metres, K=K)
    np.testing.assert_allclose(cloud.points, POINTS.reshape(-1, 3))
    assert "depth, K are not read" in cloud.notices[0] or "K, depth are not read" in cloud.notices[0]


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({}, r"has depth but no K, the camera's matrix \[3, 3\], expected both"),
        ({"K": np.eye(4)}, r"K has shape \[4, 4\], expected the camera's matrix"),
        ({"K": np.diag([-1.0, 1, 1])}, r"K is .*, expected fx 0 cx, 0 fy cy, 0 0 1 with fx and fy above 0"),
        ({"K": np.ones((3, 3))}, r"K is .*, expected fx 0 cx"),
        (
            {"K": K, "depth": np.ones((70, 80, 1))},
            r"depth is float64 \[70, 80, 1\], expected numbers \[rows, columns\]",
        ),
        ({"K": K, "depth": MASK}, r"depth is bool \[70, 80\], expected numbers"),
        ({"K": K, "depth": np.ones((20, 20))}, r"has shape \[20, 20, 3\], expected"),
    ],
)
def test_depth_images_that_are_no_points(tmp_path: Path, arrays: dict, sentence: str) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **{"depth": np.ones((70, 80)), **arrays})
    with pytest.raises(InputError, match=sentence):
        read_numpy(path, cloth_side=CLOTH)

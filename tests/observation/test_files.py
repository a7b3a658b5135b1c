"""Files of every kind come back as what they hold, and what is wrong with one is told in one sentence that names it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
import zarr

from clothkit.cloth import voxels
from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import SQUARE
from clothkit.dataset import store
from clothkit.dataset.export import Surface, encode
from clothkit.observation.cloud import observe_cloud
from clothkit.observation.files import read
from clothkit.observation.states import MeshState, PointCloud, VoxelState
from clothkit.runtime.errors import InputError
from tests.observation.pcds import written_pcd
from tests.observation.scenes import CLOTH, SCALE, folded

MESH = folded(angle=0.5)
PLACED = (MESH.astype(float) * SCALE + [0.3, -0.1, 0]).astype(np.float32)
CORNERS = np.array([[0, 0, 0], [0.4, 0, 0], [0.4, 0.4, 0], [0, 0.4, 0]], np.float32) + np.float32([0, 0, 0.001])


def exported(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    uv = (
        np.zeros((len(vertices), 2), np.float32)
        if len(vertices) != 1024
        else (SQUARE.geodesic().reshape(-1, 2) + 1) / 2
    )
    surface = Surface(0, 0, vertices.reshape(-1, 3), faces.astype(np.int32), uv)
    path.write_bytes(encode(surface, path.suffix[1:]))
    return path


@pytest.mark.parametrize("ending", ["obj", "ply", "glb"])
def test_our_own_meshes_come_back_with_their_place(tmp_path: Path, ending: str) -> None:
    state = read(exported(tmp_path / f"cloth.{ending}", PLACED, SQUARE.triangles()))
    assert isinstance(state, MeshState)
    np.testing.assert_allclose(state.mesh, MESH, atol=2e-3)
    back = state.pose.normalised_to_table(state.mesh.astype(float))
    np.testing.assert_allclose(back, PLACED, atol=1e-5)
    assert state.scale == pytest.approx(SCALE)


@pytest.mark.parametrize("ending", ["obj", "ply", "glb"])
def test_any_other_surface_is_seen_from_above(tmp_path: Path, ending: str) -> None:
    # The same surface with one triangle cut in two: no grid any more.
    faces = SQUARE.triangles()
    vertices = np.concatenate([PLACED.reshape(-1, 3), PLACED.reshape(-1, 3)[faces[0]].mean(0, keepdims=True)])
    cut = np.stack([faces[0][[0, 1]], faces[0][[1, 2]], faces[0][[2, 0]]])
    faces = np.concatenate([faces[1:], np.column_stack([cut, np.full(3, 1024)])])
    cloud = read(exported(tmp_path / f"other.{ending}", vertices, faces))
    assert isinstance(cloud, PointCloud)
    assert cloud.surface
    seen = observe_cloud(cloud, cloth_side=CLOTH)
    truth = np.asarray(voxels.observe(MESH))
    assert (seen.voxels != truth).sum() < 0.05 * truth.sum()
    np.testing.assert_allclose(seen.pose.centre, [0.3, -0.1], atol=1e-3)


def test_a_surface_of_two_triangles_is_dense(tmp_path: Path) -> None:
    cloud = read(exported(tmp_path / "two.ply", CORNERS, np.array([[0, 1, 2], [0, 2, 3]])))
    assert isinstance(cloud, PointCloud)
    assert len(cloud.points) == pytest.approx(200**2, rel=0.02)
    seen = observe_cloud(cloud, cloth_side=CLOTH)
    np.testing.assert_array_equal(seen.voxels, np.asarray(voxels.observe(SQUARE.flat())))


def test_a_ply_of_points_is_a_cloud_with_colours(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    trimesh.PointCloud(points, colors=np.tile([1, 2, 3, 255], (50, 1))).export(tmp_path / "points.ply")
    cloud = read(tmp_path / "points.ply")
    assert isinstance(cloud, PointCloud)
    np.testing.assert_allclose(cloud.points, points, atol=1e-6)
    assert cloud.colours is not None
    np.testing.assert_array_equal(cloud.colours[7], [1, 2, 3])


def test_arrays_are_told_by_their_shape(tmp_path: Path) -> None:
    shifted = MESH + np.float32([0.2, 0, 0])
    np.save(tmp_path / "mesh.npy", shifted)
    state = read(tmp_path / "mesh.npy", cloth_side=0.5)
    assert isinstance(state, MeshState)
    np.testing.assert_allclose(state.mesh, MESH, atol=1e-2)
    np.testing.assert_allclose(state.centre, [0.2, 0], atol=1e-2)
    assert state.scale == pytest.approx(0.5 / 1.4)
    seen = np.asarray(voxels.observe(MESH))
    np.savez(tmp_path / "voxels.npz", anything=seen.astype(np.uint8))
    found = read(tmp_path / "voxels.npz")
    assert isinstance(found, VoxelState)
    np.testing.assert_array_equal(found.voxels, seen)
    points = np.random.default_rng(0).normal(size=(9, 3)).astype(np.float32)
    np.savez(
        tmp_path / "cloud.npz", points=points, cloth=np.arange(9) % 2, colours=np.full((9, 3), 7), viewpoint=[0, 0, 1]
    )
    cloud = read(tmp_path / "cloud.npz")
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.points, points.astype(float))
    np.testing.assert_array_equal(cloud.cloth, np.arange(9) % 2 == 1)
    assert cloud.colours is not None
    assert cloud.colours.dtype == np.uint8


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "meshes.zarr"
    vertices = np.full((2, 4, 32, 32, 3), np.nan, np.float32)
    vertices[:, :2], vertices[1, 1] = SQUARE.flat(), MESH
    centre = np.zeros((2, 4, 2), np.float32)
    centre[1, 1] = 0.2, -0.1
    small = np.zeros(2, np.int8)
    dataset = store.Dataset(
        vertices,
        centre,
        np.zeros((2, 3, 6), np.float32),
        np.ones((2, 3), np.int8),
        small + np.int8(1),
        small,
        small > 0,
        *store.papers_cloths(2),
    )
    store.save(path, dataset, {})
    return path


def test_states_of_a_store(meshes: Path) -> None:
    state = read(f"{meshes}:1/1")
    assert isinstance(state, MeshState)
    np.testing.assert_array_equal(state.mesh, MESH)
    np.testing.assert_allclose(state.centre, [0.2, -0.1])
    assert silhouette(state.mesh).any()


def test_other_zarr_arrays(tmp_path: Path) -> None:
    seen = np.asarray(voxels.observe(MESH))
    zarr.save_array(str(tmp_path / "alone.zarr"), seen)
    assert isinstance(read(tmp_path / "alone.zarr"), VoxelState)
    group = zarr.create_group(tmp_path / "group.zarr")
    group.create_array("one", data=MESH)
    assert isinstance(read(tmp_path / "group.zarr"), MeshState)
    inner = group.create_group("inner")
    inner.create_array("points", data=np.ones((5, 3)))
    assert isinstance(read(f"{tmp_path}/group.zarr:inner"), PointCloud)
    assert isinstance(read(f"{tmp_path}/group.zarr:inner/points"), PointCloud)


def saved(**arrays: np.ndarray) -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        np.savez(folder / "bad.npz", **arrays)
        return str(folder / "bad.npz")

    return make


def written(name: str, content: bytes) -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        (folder / name).write_bytes(content)
        return str(folder / name)

    return make


def meshed(vertices: np.ndarray, name: str = "bad.ply") -> Callable[[Path], str]:
    faces = SQUARE.triangles() if vertices.size == 3072 else np.array([[0, 1, 2], [0, 2, 3]])
    return lambda folder: str(exported(folder / name, vertices.astype(np.float32), faces))


def named(name: str) -> Callable[[Path], str]:
    return lambda folder: str(folder / name)


WILD = np.where(np.arange(3072).reshape(32, 32, 3) == 5, np.float32(3e38), MESH)
NAN = np.where(np.arange(3072).reshape(32, 32, 3) == 5, np.nan, MESH)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (named("none.obj"), "not found"),
        (named("cloth.stl"), "ending '.stl' is not known, expected obj, ply, glb, pcd, npy, npz or zarr"),
        (written("bad.obj", b""), "is empty"),
        (written("bad.glb", b"no GLB at all, but long enough to look at"), "can't be read as GLB"),
        (written("bad.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n"), "can't be read as PLY"),
        (written("bad.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "holds no triangles"),
        (meshed(PLACED * 1000), "the mesh's side is 400 along its edges, expected the cloth's, 0.4 m"),
        (meshed(PLACED + np.float32([0, 0, 0.5])), "its lowest vertex is at height 0.501 m, expected the table at 0"),
        (meshed(PLACED[..., [0, 2, 1]]), "stands upright, .* if an OBJ or PLY has y up, --y-up turns it"),
        (meshed(PLACED * np.float32([1, -1, -1])), "the cloth lies below its table, .*meshes have z up"),
        (
            meshed(PLACED * np.float32(0.5)),
            "the mesh's side is 0.2 along its edges, expected the cloth's, 0.4 m",
        ),
        (
            meshed(CORNERS * np.float32([9, 9, 1])),
            "spans 3.6, expected a cloth of side 0.4 m; check its unit",
        ),
        (meshed(np.where(PLACED[3, 3, 0] == PLACED, np.nan, PLACED)), "not finite"),
        (written("bad.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), "line 4 is a face of vertex 9, there are 3"),
        (written("bad.npy", b"\x93NUMPY, but cut off"), "can't be read as NPY, it is none or is broken"),
        (written("bad.npz", b"PK, but not a zip"), "can't be read as NPZ, it is none or is broken"),
        (saved(a=np.zeros((31, 32, 3))), r"has shape \[31, 32, 3\], expected \[32, 32, 3\] \(mesh\)"),
        (saved(a=np.zeros((4, 3)), b=np.zeros(3)), "has a, b; expected one of mesh, voxels, points"),
        (saved(cloth=np.zeros(3)), "has cloth; expected one of mesh, voxels, points"),
        (saved(), "holds no array"),
        (saved(a=WILD), r"spans 3e\+38, expected a cloth of side 1.4 normalised"),
        (saved(a=NAN), "has vertices that are not finite"),
        (saved(mesh=PLACED), "the mesh's side is 0.4 along its edges, expected the cloth's, 1.4 normalised"),
        (saved(voxels=np.full((32, 32, 16), 0.5)), "has voxels other than 0 and 1"),
        (saved(voxels=np.zeros((32, 32, 16))), "has no occupied voxel"),
        (saved(points=np.array([["a", "b", "c"]])), "holds <U1, expected numbers"),
        (saved(points=np.zeros((4, 3)), cloth=np.zeros(5)), r"cloth has shape \[5\], expected \[4\]"),
        (saved(points=np.zeros((4, 3)), cloth=np.full(4, 2)), "cloth has values other than 0 and 1"),
        (
            saved(points=np.zeros((4, 3)), colours=np.ones((4, 3)) * 1.5),
            "colours are neither whole numbers 0 to 255 nor",
        ),
    ],
)
def test_a_bad_file_is_named_with_what_was_expected(tmp_path: Path, make: Callable[[Path], str], sentence: str) -> None:
    path = make(tmp_path)
    with pytest.raises(InputError, match=f"(?s)^.*({sentence})") as raised:
        read(path)
    message = str(raised.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message


def test_files_that_end_too_early_are_told_or_read_but_never_break(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    points = random.uniform(-0.2, 0.2, (60, 3)).astype(np.float32)
    np.savez(tmp_path / "a.npz", points=points)
    np.save(tmp_path / "b.npy", MESH)
    whole = [exported(tmp_path / f"c.{ending}", PLACED, SQUARE.triangles()) for ending in ("obj", "ply", "glb")]
    whole += [written_pcd(tmp_path / f"{data}.pcd", points, data) for data in ("ascii", "binary", "binary_compressed")]
    for file in [*whole, tmp_path / "a.npz", tmp_path / "b.npy"]:
        content = file.read_bytes()
        cut = tmp_path / f"cut{file.suffix}"
        told = []
        for end in random.integers(1, len(content), 8):
            cut.write_bytes(content[:end])
            try:
                read(cut)
            except InputError as error:
                told.append(str(error))
        assert told, file.name
        assert all(sentence.startswith(f"{cut}: ") and "\n" not in sentence for sentence in told)


def test_a_bad_zarr_is_named_with_what_was_expected(meshes: Path, tmp_path: Path) -> None:
    zarr.create_group(tmp_path / "bare.zarr").create_group("inner")
    (tmp_path / "broken.zarr").mkdir()
    for source, sentence in [
        (str(meshes), "is a store of meshes, expected meshes.zarr:SEQUENCE/STATE, found none"),
        (f"{meshes}:one", "expected meshes.zarr:SEQUENCE/STATE, found one"),
        (f"{meshes}:2/0", "sequence 2, state 0: not there, it holds sequences 0 to 1 with states 0 to 3"),
        (f"{meshes}:0/3", "sequence 0, state 3: not there, the sequence is shorter"),
        (f"{tmp_path}/bare.zarr", "is a group of 0 arrays, expected one"),
        (f"{tmp_path}/bare.zarr:other", "has nothing called other"),
        (f"{tmp_path}/broken.zarr", "can't be read as a zarr store"),
        (f"{tmp_path}/none.zarr:0/1", "not found"),
    ]:
        with pytest.raises(InputError, match=sentence) as raised:
            read(source)
        assert str(raised.value).startswith(source.rsplit(":", 1)[0])
        assert "\n" not in str(raised.value)
    with pytest.raises(InputError, match="cloth side -1, expected metres above 0"):
        read(f"{meshes}:0/0", cloth_side=-1.0)

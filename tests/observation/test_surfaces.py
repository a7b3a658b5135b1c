"""One cloth in the ways in which other programs write meshes: it is that cloth, or one sentence."""

import io
import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clothkit.cloth import voxels
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import SQUARE
from clothkit.observation.observe import observe
from clothkit.observation.settings import CloudConfig
from clothkit.observation.states import MeshState, PointCloud
from clothkit.observation.surfaces import read_surface
from clothkit.runtime.errors import InputError
from tests.observation.scenes import CLOTH, SCALE, cornered
from tests.observation.test_grids import sheet

MESH = cornered()
V, T = MESH.reshape(-1, 3), SQUARE.triangles()
INDEX = np.arange(1024).reshape(*SQUARE.shape)
QUADS = np.stack([INDEX[:-1, :-1], INDEX[1:, :-1], INDEX[1:, 1:], INDEX[:-1, 1:]], -1).reshape(-1, 4)
APART = V[T].reshape(-1, 3)
ORDER = np.random.default_rng(0).permutation(1024)
HALVES = ((0, 900), (900, len(T)))
TRUTH = np.asarray(voxels.observe(centred((MESH / SCALE).astype(np.float32))[0]))


def is_the_cloth(state: MeshState | PointCloud, *, labelled: bool = True) -> None:
    """A mesh: vertex by vertex where it lay, in the file's order or any of the eight that are symmetric to it."""
    assert isinstance(state, MeshState)
    back = state.pose.normalised_to_table(state.mesh.astype(float))
    sides = (MESH, MESH.transpose(1, 0, 2))
    orders = [MESH] if labelled else [np.rot90(side, turns) for side in sides for turns in range(4)]
    assert min(float(np.abs(back - order).max()) for order in orders) < 1e-5


def looks_like_the_cloth(cloud: MeshState | PointCloud, settings: CloudConfig = CloudConfig()) -> None:  # noqa: B008
    assert isinstance(cloud, PointCloud)
    seen = observe(cloud, cloth_side=CLOTH, settings=settings)
    assert (seen.voxels & TRUTH).sum() > 0.9 * (seen.voxels | TRUTH).sum()
    assert (seen.voxels[::-1] & TRUTH).sum() < 0.8 * (seen.voxels[::-1] | TRUTH).sum()


# OBJ


def lines(vertices: np.ndarray = V, *, ending: str = "") -> list[str]:
    return [f"v {x:.7f} {y:.7f} {z:.7f}{ending}" for x, y, z in vertices.tolist()]


def faces(of: np.ndarray | Sequence[Sequence[int]] = T, write: Callable[[int], str] = str) -> list[str]:
    return ["f " + " ".join(write(int(corner) + 1) for corner in face) for face in of]


def seam() -> list[str]:
    """Half of the faces have texture coordinates of their own, in the order in which they are met."""
    texture = [f"vt {u / 31:.4f} {v / 31:.4f}" for u in range(32) for v in range(32)]
    corners = [faces(part, lambda i, off=off: f"{i}/{i + off}/1") for part, off in ((T[:900], 0), (T[900:], 1024))]
    return [*lines(), *texture, *texture, "vn 0 0 1", *corners[0], *corners[1]]


def interleaved() -> list[str]:
    """Each triangle after its own vertices, which it counts back to."""
    return [line for triangle in T for line in (*lines(V[triangle]), "f -3/-3 -2/-2 -1/-1")]


def between(*words: str) -> list[str]:
    return [*lines(), *(line for word, (a, b) in zip(words, HALVES, strict=True) for line in (word, *faces(T[a:b])))]


OBJS = {
    "triangles": [*lines(), *faces()],
    "quads": [*lines(), *faces(QUADS)],
    "normals": [*lines(), "vn 0 0 1", *faces(T, lambda i: f"{i}//1")],
    "seam": seam(),
    "negative": [*lines(), *(f"f {a - 1024} {b - 1024} {c - 1024}" for a, b, c in T)],
    "interleaved negative": interleaved(),
    "materials": ["mtllib none.mtl", *between("usemtl red", "usemtl blue")],
    "objects": between("o front", "o back"),
    "groups": between("g front", "g back"),
    "each face its own vertices": [*lines(APART), *faces(np.arange(len(APART)).reshape(-1, 3))],
    "both sides": [*lines(), *faces(np.concatenate([T, T[:, ::-1]]))],
    "colours": [*lines(ending=" 0.8 0.2 0.1"), *faces()],
    "weights": [*lines(ending=" 1.0"), *faces()],
    "tabs": [line.replace(" ", "\t") for line in [*lines(), *faces()]],
    "continued": [*lines(), *(line.replace(" ", " \\\n", 2) for line in faces())],
    "more vertices than are used": [*lines(np.concatenate([V, [[5, 5, 5], [6, 6, 6]]])), *faces()],
    "faces first": [*faces(), *lines()],
}


@pytest.mark.parametrize("newline", ["\n", "\r\n"], ids=["unix", "windows"])
@pytest.mark.parametrize("name", OBJS)
def test_obj(tmp_path: Path, name: str, newline: str) -> None:
    path = tmp_path / "cloth.obj"
    path.write_bytes(newline.join(["# by hand", *OBJS[name], ""]).replace("\\\n", f"\\{newline}").encode())
    is_the_cloth(read_surface(path, cloth_side=CLOTH))


def test_obj_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "cloth.obj"
    path.write_text("\n".join([*lines(V[ORDER]), *faces(np.argsort(ORDER)[T])]))
    is_the_cloth(read_surface(path, cloth_side=CLOTH), labelled=False)
    # Which order it is makes no difference for what is seen, either.
    seen = observe(read_surface(path, cloth_side=CLOTH), cloth_side=CLOTH)
    assert (seen.voxels != TRUTH).sum() < 0.01 * TRUTH.sum()


# PLY

_PLY = {"f": "float", "d": "double", "B": "uchar", "h": "short", "i": "int"}


def ply(
    path: Path,
    vertices: np.ndarray,
    polygons: Sequence[Sequence[int]] | np.ndarray | None = None,
    *,
    kind: str = "f",
    more: dict[str, tuple[str, np.ndarray]] | None = None,
    order: str = "<",
    lists: str = "face",
    head: str = "",
) -> Path:
    """Vertices, with more columns, and lists of whole numbers; `order` t is text."""
    columns = {axis: (kind, vertices[:, k]) for k, axis in enumerate("xyz")} | (more or {})
    names = {"<": "binary_little_endian", ">": "binary_big_endian", "t": "ascii"}
    text = [
        "ply",
        f"format {names[order]} 1.0",
        "comment by hand",
        *head.splitlines(),
        f"element vertex {len(vertices)}",
    ]
    text += [f"property {_PLY[one]} {name}" for name, (one, _) in columns.items()]
    if polygons is not None:
        text += [f"element {lists} {len(polygons)}", "property list uchar int vertex_indices"]
    rows = list(zip(*(column.tolist() for _, column in columns.values()), strict=True))
    code = "".join(one for one, _ in columns.values())
    some = [] if polygons is None else [[len(polygon), *map(int, polygon)] for polygon in polygons]
    if order == "t":
        body = "".join(" ".join(map(repr, row)) + "\n" for row in [*rows, *some]).encode()
    else:
        body = b"".join(struct.pack(order + code, *row) for row in rows)
        body += b"".join(struct.pack(f"{order}B{len(row) - 1}i", *row) for row in some)
    path.write_bytes("\n".join([*text, "end_header", ""]).encode() + body)
    return path


MIXED: list[list[int]] = [*QUADS[:400].tolist(), *sheet(*SQUARE.shape, np.ones(961, bool))[800:].tolist()]

# Of each second pair of quads a triangle and a pentagon: as many bytes as quads.
EVEN: list[list[int]] = []
for _one, _other in zip(QUADS[0::2].tolist(), QUADS[1::2].tolist(), strict=False):
    (_a, _b, _c, _d), (_e, _f, _g, _h) = _one, _other
    EVEN += [[_a, _b, _d], [_d, _b, _c, _g, _h]] if (_d, _c) == (_e, _f) else [_one, _other]
EVEN.append(QUADS[-1].tolist())


@pytest.mark.parametrize("order", ["<", ">", "t"])
@pytest.mark.parametrize("polygons", [T, QUADS, MIXED, EVEN], ids=["triangles", "quads", "mixed", "even"])
def test_ply(tmp_path: Path, polygons: Sequence[Sequence[int]], order: str) -> None:
    is_the_cloth(read_surface(ply(tmp_path / "cloth.ply", V, polygons, order=order), cloth_side=CLOTH))
    normals = dict.fromkeys(("nx", "ny", "nz"), ("f", V[:, 0] * 0))
    path = ply(tmp_path / "more.ply", V, polygons, order=order, kind="d", more=normals)
    is_the_cloth(read_surface(path, cloth_side=CLOTH))


def test_ply_with_a_seam(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    texture = {name: ("f", random.random(len(APART))) for name in "st"}
    path = ply(tmp_path / "cloth.ply", APART, np.arange(len(APART)).reshape(-1, 3), more=texture)
    is_the_cloth(read_surface(path, cloth_side=CLOTH), labelled=False)


# What a camera 0.8 m above the table sees, y up and z towards it, cloth and table in rows and columns.
_GRID = np.stack(np.meshgrid(np.arange(-0.4, 0.6, 0.005), np.arange(-0.5, 0.4, 0.005), indexing="ij"), -1)
RED, GREEN = [200, 60, 40], [40, 110, 50]
BY_COLOUR = CloudConfig(table_colour=((0, 80, 0), (90, 150, 100)))


@pytest.fixture(scope="module")
def view() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [n, 3], colours [n, 3], and the triangles between neighbours."""
    rows, columns = _GRID.shape[:2]
    fine = cornered(600).reshape(-1, 3)
    cell = np.rint((fine[:, :2] - _GRID[0, 0]) / 0.005).astype(int)
    height = np.full((rows, columns), -1.0)
    np.maximum.at(height, tuple(cell.T), fine[:, 2])
    height = height.ravel()
    points = np.column_stack([_GRID.reshape(-1, 2), np.maximum(height, 0) - 0.8])
    colours = np.where(height[:, None] > 0, RED, GREEN)
    return points, colours, sheet(rows, columns, np.ones((rows - 1) * (columns - 1), bool))


def coloured(colours: np.ndarray, names: Sequence[str] = ("red", "green", "blue")) -> dict[str, tuple[str, np.ndarray]]:
    return {name: ("B", colours[:, k]) for k, name in enumerate(names)}


def test_what_a_depth_camera_meshed_is_points(tmp_path: Path, view: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    points, colours, between = view
    path = ply(tmp_path / "meshed.ply", points, between, more=coloured(colours))
    state = read_surface(path, cloth_side=CLOTH)
    assert state.notices == (f"{path}: holds a mesh with colours that does not lie on z = 0: taken for points that a "
                             "camera measured, without faces",)  # fmt: skip
    looks_like_the_cloth(state, BY_COLOUR)
    assert isinstance(state, PointCloud)
    assert not state.surface
    # Without colours, or on the table, it could be a mesh in a wrong unit, and must be asked for.
    on_table = ply(tmp_path / "table.ply", points + np.array([0, 0, 0.8]), between, more=coloured(colours))
    for other in (ply(tmp_path / "bare.ply", points, between), on_table):
        with pytest.raises(InputError, match="--as-points if its vertices are what a camera measured"):
            read_surface(other, cloth_side=CLOTH)
        cloud = read_surface(other, cloth_side=CLOTH, as_points=True)
        assert isinstance(cloud, PointCloud)
        assert len(cloud.points) == len(points)
        assert not cloud.notices


@pytest.mark.parametrize(
    "names", [("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"), ("red", "green", "blue")], ids=str
)
@pytest.mark.parametrize("order", ["<", "t"])
def test_ply_colours(tmp_path: Path, names: Sequence[str], order: str) -> None:
    random = np.random.default_rng(2)
    points, colours = random.normal(size=(50, 3)), random.integers(0, 256, (50, 3))
    cloud = read_surface(ply(tmp_path / "a.ply", points, more=coloured(colours, names), order=order), cloth_side=CLOTH)
    assert isinstance(cloud, PointCloud)
    np.testing.assert_array_equal(cloud.colours, colours)
    np.testing.assert_allclose(cloud.points, points, atol=1e-6)
    dark = read_surface(
        ply(tmp_path / "b.ply", points, more=coloured(colours % 2, names), order=order), cloth_side=CLOTH
    )
    assert isinstance(dark, PointCloud)
    np.testing.assert_array_equal(dark.colours, colours % 2)


def test_ply_with_lists_beside_points(tmp_path: Path) -> None:
    """As organised clouds have them: for each pixel its point, or none."""
    random = np.random.default_rng(3)
    points, colours = random.normal(size=(60, 3)), random.integers(0, 256, (60, 3))
    grid = [[k // 2] if k % 2 else [] for k in range(120)]
    path = ply(
        tmp_path / "range.ply",
        points,
        grid,
        more=coloured(colours, ("diffuse_red", "diffuse_green", "diffuse_blue")),
        lists="range_grid",
        head="obj_info num_cols 12\nobj_info num_rows 10",
    )
    cloud = read_surface(path, cloth_side=CLOTH)
    assert isinstance(cloud, PointCloud)
    np.testing.assert_allclose(cloud.points, points, atol=1e-6)
    np.testing.assert_array_equal(cloud.colours, colours)


# GLB


def glb(path: Path, parts: dict[str, tuple[np.ndarray, np.ndarray]], *, move: Sequence[float] = (0, 0, 0)) -> Path:
    """Parts in y up, each under a node of its name."""
    scene = trimesh.Scene()
    for name, (vertices, indices) in parts.items():
        turned = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=-1) - move
        mesh = trimesh.Trimesh(turned, indices, process=False)
        transform = trimesh.transformations.translation_matrix(move)
        scene.add_geometry(mesh, node_name=name, geom_name=name, transform=transform)
    path.write_bytes(scene.export(file_type="glb"))
    return path


def test_glb(tmp_path: Path) -> None:
    is_the_cloth(read_surface(glb(tmp_path / "one.glb", {"cloth": (V, T)}), cloth_side=CLOTH))
    moved = glb(tmp_path / "moved.glb", {"cloth": (V, T)}, move=(0.3, 0.1, -0.2))
    is_the_cloth(read_surface(moved, cloth_side=CLOTH))
    parts = {"front": (V, T[:900]), "back": (V, T[900:])}
    is_the_cloth(read_surface(glb(tmp_path / "two.glb", parts), cloth_side=CLOTH))
    apart = {"cloth": (APART, np.arange(len(APART)).reshape(-1, 3))}
    is_the_cloth(read_surface(glb(tmp_path / "apart.glb", apart), cloth_side=CLOTH), labelled=False)


def test_two_halves_of_another_grid_are_one_surface(tmp_path: Path) -> None:
    """Estimated, since it is no grid of ours, from above and not in halves."""
    middles = V[T].mean(1)
    finer = np.concatenate([V, middles])
    corner = 1024 + np.arange(len(T))
    cut = np.concatenate([np.column_stack([T[:, [k, (k + 1) % 3]], corner]) for k in range(3)])
    parts = {"front": (finer, cut[:3000]), "back": (finer, cut[3000:])}
    state = read_surface(glb(tmp_path / "finer.glb", parts), cloth_side=CLOTH)
    looks_like_the_cloth(state)
    assert isinstance(state, PointCloud)
    assert state.surface


def edited(path: Path, edit: Callable[[dict], None]) -> Path:
    """A GLB with its description changed."""
    content = path.read_bytes()
    size = struct.unpack_from("<I", content, 12)[0]
    description = json.loads(content[20 : 20 + size])
    edit(description)
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    path.write_bytes(head + text + rest)
    return path


def draco(description: dict) -> None:
    description["extensionsRequired"] = description["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    for mesh in description["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    for accessor in description["accessors"]:
        accessor.pop("bufferView")


def repeated(description: dict) -> None:
    description["nodes"] += [{"mesh": 0, "name": f"copy {k}"} for k in range(30_000)]
    description["nodes"][0]["children"] = list(range(len(description["nodes"]) - 30_000, len(description["nodes"])))


def vast(description: dict) -> None:
    description["accessors"][0].pop("bufferView")
    description["accessors"][0]["count"] = 10**11


TABLE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
HEADER = b"ply\nformat %b 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


def raw(content: bytes) -> Callable[[Path], Path]:
    def make(path: Path) -> Path:
        path.write_bytes(content)
        return path

    return make


def with_table(path: Path) -> Path:
    return glb(path, {"cloth": (V, T), "table": (TABLE, np.array([[0, 1, 2], [0, 2, 3]]))})


@pytest.mark.parametrize(
    ("name", "make", "sentence"),
    [
        ("a.glb", lambda p: edited(glb(p, {"a": (V, T)}), draco), "compressed by Draco .*, expected plain triangles"),
        ("a.glb", lambda p: edited(glb(p, {"a": (V, T)}), vast), "an array of 100000000000 numbers is more than"),
        ("a.glb", lambda p: edited(glb(p, {"a": (V, T)}), repeated), "holds 30,?... objects of 30.* vertices"),
        ("a.glb", with_table, "holds 2 objects that share no vertices .among cloth, table., expected one cloth"),
        ("a.ply", raw(HEADER % (b"ascii", 0)), "holds no vertices; if a camera took it, its view is empty"),
        ("a.ply", raw(HEADER % (b"ascii", 10**12)), "its header says 1000000000000 rows of vertex, more than the file"),
        ("a.ply", raw(HEADER % (b"binary_little_endian", 10**12)), "says 1000000000000 rows of vertex, more than"),
        ("a.ply", raw((HEADER % (b"ascii", 1)).replace(b" 1\n", b" -1\n")), "header has the line 'element vertex -1'"),
        (
            "a.ply",
            raw((HEADER % (b"ascii", 1)).replace(b"float x", b"real x")),
            "header has the line 'property real x'",
        ),
        ("a.ply", raw((HEADER % (b"ascii", 2)) + b"1 2 3\n4 5 six\n"), "point 1 is '4 5 six', expected 3 numbers"),
        (
            "a.ply",
            raw((HEADER % (b"ascii", 3)) + b"1 2 3\n4 5 6  \n" + b" " * 20),
            "ends after 2 points, its header says 3",
        ),
        ("a.ply", lambda p: ply(p, V, [[0, 1, 2]], lists="tristrips"), "holds triangle strips, expected faces"),
        ("a.ply", lambda p: ply(p, V, [[0, 1, 2], [0, 1, 2, 5000]]), "can't be read as PLY|between vertices that it"),
        ("a.obj", raw(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n"), "line 4 is no face: 'f 1 2 0'"),
        ("a.obj", raw(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n"), "line 4 is a face of vertices that are not there"),
        ("a.obj", raw(b"v 0 0 0\nv 1 0 0\nf 1 2\n"), "line 3 is no face: 'f 1 2'"),
        ("a.obj", raw(b"v 0 0 0\nv 1 0 0\n"), "holds no triangles; if its vertices are what a camera measured, give"),
        ("a.obj", raw(b"v 0 0 1e300\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "not finite, or farther away than any cloth's"),
        ("a.obj", raw(b"# nothing\n"), "holds no vertices; if a camera took it, its view is empty"),
    ],
)
def test_bad_files_get_one_sentence(tmp_path: Path, name: str, make: Callable[[Path], Path], sentence: str) -> None:
    path = make(tmp_path / name)
    with pytest.raises(InputError, match=sentence) as raised:
        read_surface(path, cloth_side=CLOTH)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


def test_points_in_other_formats_are_points_when_asked_for(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("\n".join(lines(ending=" 1 0 0.5")))
    cloud = read_surface(tmp_path / "a.obj", cloth_side=CLOTH, as_points=True)
    assert isinstance(cloud, PointCloud)
    np.testing.assert_allclose(cloud.points, V, atol=1e-6)
    np.testing.assert_allclose(cloud.colours, np.tile([255, 0, 128], (1024, 1)), atol=1)
    out = io.BytesIO()
    trimesh.Scene([trimesh.PointCloud(V[:, [0, 2, 1]] * [1, 1, -1])]).export(file_obj=out, file_type="glb")
    (tmp_path / "a.glb").write_bytes(out.getvalue())
    cloud = read_surface(tmp_path / "a.glb", cloth_side=CLOTH, as_points=True)
    assert isinstance(cloud, PointCloud)
    np.testing.assert_allclose(cloud.points, V, atol=1e-6)

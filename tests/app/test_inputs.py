"""What commands make of files beside reading them: what is said of them, and what options change."""

from pathlib import Path

import numpy as np
import pytest

from clothkit.app.inputs import Input, read_input
from clothkit.app.options import observation_options
from clothkit.app.planner import usage_of
from clothkit.app.settings import AppConfig
from clothkit.app.viewer.live_panel import keep_upload
from clothkit.cloth.topology import SQUARE
from clothkit.observation.camera import CameraConfig, back_project, render
from clothkit.observation.states import PointCloud
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.errors import InputError
from tests.observation.scenes import cornered
from tests.observation.test_surfaces import V, coloured, faces, glb, lines, ply

TABLE = (0.0, 0.0, -1.0, -0.8)
COLOURS = (0, 80, 0, 90, 150, 100)
CAMERA = CameraConfig(columns=160, rows=120, focal=147.5)


def read_with(**options: object) -> Input:
    file = str(options.pop("file"))
    how: dict = {"side": 0.4, "table": None, "table_colour": None, "box": None, **options}
    return read_input(file, observation_options(AppConfig(), **how))


def meshed(path: Path) -> Path:
    """What a camera measured, some of it joined by triangles, without colours."""
    cloud = back_project(render(cornered(), SQUARE.triangles(), CAMERA))
    points = cloud.points[cloud.cloth]
    return ply(path, points, [[k, k + 1, k + 2] for k in range(0, len(points) - 2, 3)])


def test_as_points_takes_what_is_no_grid_for_measured(tmp_path: Path) -> None:
    path = meshed(tmp_path / "meshed.ply")
    with pytest.raises(InputError, match="lowest vertex is at height"):
        read_with(file=path, table=TABLE)
    seen = read_with(file=path, table=TABLE, as_points=True)
    assert seen.kind == "points"
    np.testing.assert_allclose(seen.pose.scale, 0.4 / 1.4)
    # A goal that is a grid stays what it is.
    goal = tmp_path / "goal.obj"
    goal.write_text("\n".join([*lines(), *faces()]))
    assert read_with(file=goal, table=TABLE, as_points=True).kind == "mesh"


def test_what_is_to_be_said_of_a_file_is_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cloud = back_project(render(cornered(), SQUARE.triangles(), CAMERA))
    np.savez(tmp_path / "a.npz", points=cloud.points, mask=cloud.cloth, K=np.eye(3))
    read_with(file=tmp_path / "a.npz")
    said = capsys.readouterr()
    assert not said.out
    assert said.err == f"notice: {tmp_path}/a.npz: K is not read; of names beside the points, cloth, colours and " \
        "viewpoint are known\n"  # fmt: skip
    colours = np.where(cloud.cloth[:, None], [200, 60, 40], [40, 110, 50])
    path = ply(tmp_path / "b.ply", cloud.points, [[0, 1, 2]], more=coloured(colours))
    seen = read_with(file=path, table_colour=COLOURS)
    assert isinstance(seen.state, PointCloud)
    assert capsys.readouterr().err.startswith(f"notice: {path}: holds a mesh with colours")


def test_meshes_are_taken_as_they_are_by_those_that_plan_from_meshes(tmp_path: Path) -> None:
    mesh = read_with(file=glb(tmp_path / "a.glb", {"cloth": (V, SQUARE.triangles())}))
    other = glb(tmp_path / "b.glb", {"cloth": (V, SQUARE.triangles()[:-1])})
    surface = read_with(file=other)
    assert (mesh.kind, surface.kind) == ("mesh", "points")
    for name, system in SYSTEMS.items():
        assert usage_of(system, mesh) == ("as it is" if name in ("b1", "b4", "b5") else "estimated"), name
        assert usage_of(system, mesh, goal=True) == "as it is"
        assert usage_of(system, surface, goal=True) == ("as it is" if name in ("b4", "b5") else "estimated"), name


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("cloth.obj", "cloth.obj"),
        ("C:\\cloths\\a.ply", "a.ply"),
        ("../../b.npz", "b.npz"),
        ("", "state"),
        ("\0", "state"),
    ],
)
def test_uploads_stay_in_their_folder(tmp_path: Path, name: str, kept: str) -> None:
    path = keep_upload(tmp_path, "state", name, b"one")
    assert path == tmp_path / "state" / kept
    # The goal's file of the same name is another one.
    assert keep_upload(tmp_path, "goal", name, b"two") != path
    assert path.read_bytes() == b"one"


@pytest.mark.parametrize("name", ["..", "n" * 300])
def test_uploads_that_can_not_be_kept_get_one_sentence(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="can't be written") as raised:
        keep_upload(tmp_path, "state", name, b"one")
    assert "\n" not in str(raised.value)


def test_a_cloud_in_map_coordinates_is_refused_before_anything_is_planned(tmp_path: Path) -> None:
    cloud = back_project(render(cornered(), SQUARE.triangles(), CAMERA))
    for shift, refused in ((90.0, False), (120.0, True)):
        np.savez(tmp_path / "cloud.npz", points=cloud.points + np.array([shift, 0, 0]), cloth=cloud.cloth)
        if not refused:
            assert read_with(file=tmp_path / "cloud.npz", table=TABLE).kind == "points"
            continue
        with pytest.raises(InputError, match="the cloth is 120 m away from its frame's origin"):
            read_with(file=tmp_path / "cloud.npz", table=TABLE)


def test_a_cloud_that_covers_more_than_its_rectangle_is_refused(tmp_path: Path) -> None:
    """A towel of 0.6 x 0.4 m that is called 0.6 x 0.2 m."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.3, -0.2, 0.002], [0.3, 0.2, 0.004], (20000, 3))
    np.savez(tmp_path / "towel.npz", points=points)
    level = (0.0, 0.0, 1.0, 0.0)
    good = observation_options(AppConfig(), side=None, sides=(0.4, 0.6), table=level)
    assert read_input(str(tmp_path / "towel.npz"), good).observation.voxels.any()
    narrow = observation_options(AppConfig(), side=None, sides=(0.6, 0.2), table=level)
    with pytest.raises(InputError, match=r"covers 0\.2\d m², more than one of 0\.6 x 0\.2 m can; check its sides"):
        read_input(str(tmp_path / "towel.npz"), narrow)

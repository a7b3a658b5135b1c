"""What stands upright is refused, and what the viewport does not hold is told."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.cloth.voxels import HEIGHT, VIEWPORT, Viewport
from clothkit.observation.cloud import observe_cloud
from clothkit.observation.heights import check_above, check_lying, clamped, notices_of_points
from clothkit.observation.observe import observe
from clothkit.observation.plane import LEVEL
from clothkit.observation.states import MeshState, PointCloud, VoxelState
from clothkit.runtime.errors import InputError
from tests.observation.scenes import CLOTH, SCALE, folded, turned

REMEDY = "turn it"
ZERO = np.zeros(2, np.float32)


def standing(mesh: np.ndarray) -> np.ndarray:
    """The mesh as a file with y up has it, on its edge at height 0."""
    found = mesh[..., [0, 2, 1]] * np.float32([1, 1, 1])
    return np.asarray(found - np.array([0, 0, found[..., 2].min()], np.float32))


@given(st.floats(0, np.pi), st.floats(-0.5, 0.5))
def test_what_lies_passes_and_what_stands_does_not_however_it_is_turned(angle: float, along: float) -> None:
    lying = folded(along=along)
    check_lying("file", turned(lying, angle).reshape(-1, 3), side=CLOTH_LENGTH, remedy=REMEDY)
    with pytest.raises(InputError, match=r"^file: the cloth stands upright, .*; turn it$"):
        check_lying("file", turned(standing(lying), angle).reshape(-1, 3), side=CLOTH_LENGTH, remedy=REMEDY)


def test_a_heap_lies_and_a_strip_on_its_edge_stands() -> None:
    random = np.random.default_rng(0)
    # Crumpled, as wide as high is usual: 70 mm of 250.
    heap = random.uniform([-0.3, -0.3, 0], [0.3, 0.3, 0.28], (500, 3))
    check_lying("heap", heap, side=1.0, remedy=REMEDY)
    strip = random.uniform([-0.5, -0.02, 0], [0.5, 0.02, 0.25], (500, 3))
    with pytest.raises(InputError, match=r"0\.2[0-9] of its side high and 0\.0[0-9] wide"):
        check_lying("strip", strip, side=1.0, remedy=REMEDY)


def test_a_mesh_that_stands_or_lies_below_its_table_is_refused_with_the_option_that_turns_it() -> None:
    for mesh in (standing(SQUARE.flat()), standing(folded())):
        with pytest.raises(InputError, match=r"stands upright.*--y-up"):
            observe(MeshState(mesh, ZERO, SCALE), cloth_side=CLOTH)
    with pytest.raises(InputError, match=r"lies below its table.*z up"):
        observe(MeshState(folded() * np.float32([1, -1, -1]), ZERO, SCALE), cloth_side=CLOTH)
    # A little is rounding, or a table that is a little off.
    check_above("file", (folded() - np.float32([0, 0, 0.005])).reshape(-1, 3), side=CLOTH_LENGTH, remedy=REMEDY)


def test_voxels_that_reach_the_top_are_told_and_a_wall_is_refused() -> None:
    cloth = np.zeros((32, 32, 16), bool)
    cloth[6:26, 6:26, 0] = True
    assert not observe(VoxelState(cloth), cloth_side=CLOTH).notices
    cloth[6:8, 6:16, :] = True
    (notice,) = observe(VoxelState(cloth), cloth_side=CLOTH, name="voxels").notices
    assert notice.startswith("voxels: 5% of the cloth's columns reach the viewport's upper end")
    wall = np.zeros((32, 32, 16), bool)
    wall[4:28, 16] = True
    with pytest.raises(InputError, match=r"voxels: 100% .* upright"):
        observe(VoxelState(wall), cloth_side=CLOTH, name="voxels")


def test_more_than_two_in_a_hundred_points_above_the_viewport_are_told() -> None:
    points = np.zeros((1000, 3))
    points[:20, 2] = HEIGHT + 0.01
    assert clamped(points, viewport=VIEWPORT) == 0.02
    assert not notices_of_points("towel", points, viewport=VIEWPORT, metres=SCALE)
    points[:30, 2] = HEIGHT
    (notice,) = notices_of_points("towel", points, viewport=VIEWPORT, metres=SCALE)
    # 0.125 of a unit of 0.4 / 1.4 m.
    assert notice.startswith("towel: 3% of the cloth lies higher than nets see, whose viewport ends 36 mm above")
    assert not notices_of_points("towel", points, viewport=Viewport(height=2 * HEIGHT), metres=SCALE)
    points[:, 2] = 0
    points[:200, 2] = -HEIGHT / 16 - 0.001
    (notice,) = notices_of_points("towel", points, viewport=VIEWPORT, metres=SCALE)
    assert notice.startswith("towel: 20% of the cloth lies below the table")


def test_meshes_and_clouds_tell_what_they_clamp() -> None:
    # A thick towel: its strip lies two layers, and so 42 mm, high.
    mesh = folded(along=0.3) * np.float32([1, 1, 4])
    assert (mesh[..., 2] > HEIGHT).mean() < 0.02
    thick = folded(along=0.3) * np.float32([1, 1, 7])
    (notice,) = observe(MeshState(thick, ZERO, SCALE), cloth_side=CLOTH, name="mesh").notices
    share = (thick[..., 2] >= HEIGHT).mean()
    assert float(notice.split("%")[0].split()[-1]) == pytest.approx(100 * share, abs=2)
    x, y = (part.ravel() for part in np.meshgrid(np.arange(-0.2, 0.2, 0.004), np.arange(-0.2, 0.2, 0.004)))
    cloud = PointCloud(np.column_stack([x, y, np.where(x > 0.1, 0.05, 0.004)]), table=LEVEL)
    (notice,) = observe_cloud(cloud, cloth_side=CLOTH, name="cloud").notices
    assert notice.startswith("cloud: 2")
    assert "% of the cloth lies higher than nets see" in notice
    assert not observe_cloud(PointCloud(np.column_stack([x, y, x * 0 + 0.004]), table=LEVEL), cloth_side=CLOTH).notices

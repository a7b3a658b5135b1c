"""One door for meshes, voxels and clouds."""

import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.observation.camera import CameraConfig, back_project
from clothkit.observation.coverage import goal_iou
from clothkit.observation.observe import observe
from clothkit.observation.states import MeshState, VoxelState
from clothkit.runtime.errors import InputError
from tests.observation.scenes import CLOTH, SCALE, folded, image_of

MESH = folded()
TRUTH = np.asarray(voxels.observe(MESH))


def test_meshes_voxels_and_clouds_of_one_cloth_agree() -> None:
    mesh = observe(MeshState(MESH, np.float32([0.1, 0.2]), SCALE), cloth_side=CLOTH)
    np.testing.assert_array_equal(mesh.voxels, TRUTH)
    np.testing.assert_allclose(mesh.pose.centre, np.array([0.1, 0.2]) * SCALE, rtol=1e-6)
    known = observe(VoxelState(TRUTH), cloth_side=CLOTH)
    np.testing.assert_array_equal(known.voxels, TRUTH)
    cloud = observe(back_project(image_of(MESH, CameraConfig())), cloth_side=CLOTH)
    assert (cloud.voxels != TRUTH).sum() < 0.05 * TRUTH.sum()
    for seen in (mesh, known, cloud):
        # A voxel is 0.06 wide, and one that is touched counts whole.
        assert goal_iou(MESH, seen.points) > (0.85 if seen is known else 0.95)
        assert seen.points[:, 2].max() == pytest.approx(MESH[..., 2].max(), abs=0.005)


def test_voxels_are_occluded_and_centred_by_whole_ones() -> None:
    block = np.zeros((32, 32, 16), bool)
    block[2:10, 20:26, 3] = True
    seen = observe(VoxelState(block), cloth_side=CLOTH)
    expected = np.zeros((32, 32, 16), bool)
    expected[12:20, 13:19, :4] = True
    np.testing.assert_array_equal(seen.voxels, expected)
    np.testing.assert_allclose(seen.pose.centre, np.array([-10, 7]) * (2 / 32) * SCALE)
    np.testing.assert_allclose(seen.points.mean(0), [0, 0, 3.5 * 0.125 / 16], atol=1e-6)


def test_voxels_that_are_none_or_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="box: has no occupied voxel"):
        observe(VoxelState(np.zeros((32, 32, 16), bool)), cloth_side=CLOTH, name="box")
    lopsided = np.zeros((32, 32, 16), bool)
    lopsided[0, :, 0], lopsided[:, 0, 0] = True, True
    with pytest.raises(InputError, match="box: the cloth does not fit into the viewport once it is centred"):
        observe(VoxelState(lopsided), cloth_side=CLOTH, name="box")

"""Pictures of simulated cloths: where cloths are seen, how noise grows, what can't be seen."""

import dataclasses

import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.observation.noise import NoiseConfig
from clothkit.observation.picture import PictureConfig, take
from clothkit.runtime.errors import InputError
from tests.observation.scenes import SMALL, folded

CLEAN = PictureConfig(camera=SMALL, noise=None)


@pytest.mark.parametrize("tilt", [0.0, 0.35])
def test_a_cloth_is_seen_where_it_lies_and_as_it_is(tilt: float) -> None:
    mesh = folded(angle=0.4)
    picture = take(mesh, dataclasses.replace(CLEAN, camera=dataclasses.replace(SMALL, tilt=tilt)))
    # The axes are the mesh's: voxels under other axes would hardly agree. 0.03 normalised: 9 mm.
    assert np.linalg.norm(picture.shift) < 0.03
    assert (picture.observation.voxels != np.asarray(voxels.observe(mesh))).mean() < 0.02
    assert picture.attempts == 1


def test_the_same_mesh_gives_the_same_picture() -> None:
    noisy = dataclasses.replace(CLEAN, noise=NoiseConfig())
    one, two = take(folded(), noisy), take(folded(), noisy)
    np.testing.assert_array_equal(one.image.depth, two.image.depth)
    other = take(folded(), dataclasses.replace(noisy, seed=1))
    assert (one.image.depth != other.image.depth).any()


def test_more_noise_shows_in_the_voxels() -> None:
    mesh = folded(angle=0.4)
    truth = np.asarray(voxels.observe(mesh))
    off = [
        (take(mesh, dataclasses.replace(CLEAN, noise=NoiseConfig().times(k))).observation.voxels != truth).mean()
        for k in (1.0, 4.0, 16.0)
    ]
    assert off[0] < off[1] < off[2]


def test_noise_is_multiplied_as_a_whole() -> None:
    one, twice = NoiseConfig(), NoiseConfig().times(2.0)
    assert (twice.axial, twice.lateral, twice.holes) == (2 * one.axial, 2 * one.lateral, 2 * one.holes)
    assert twice.edge_dropout == 1.0
    assert (twice.edge, twice.grazing) == (one.edge, one.grazing)
    assert one.times(1.0) == one


def test_a_camera_that_looks_elsewhere_is_told() -> None:
    away = dataclasses.replace(SMALL, aim=(3.0, 0.0))
    with pytest.raises(InputError, match="picture"):
        take(folded() + np.float32([50, 0, 0]), dataclasses.replace(CLEAN, camera=away, noise=NoiseConfig()))

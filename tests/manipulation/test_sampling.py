import numpy as np

from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.candidates import CandidateConfig, candidates
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.sampling import SamplingConfig, draw_hands, sample

SETTINGS, GRASPING = SamplingConfig(), CandidateConfig()


def test_samples_obey_the_three_restrictions() -> None:
    mesh = SQUARE.flat()
    rng = np.random.default_rng(0)
    corners = candidates(mesh, GRASPING)
    image = silhouette(mesh)
    for hands in (1, 2) * 10:
        drawn = sample(rng, mesh, hands, SETTINGS, GRASPING)
        assert drawn is not None
        assert drawn.single == (hands == 1)
        grasps = mesh.reshape(-1, 3)[list(drawn.vertices), :2]
        for grasp in grasps:
            assert np.linalg.norm(corners - grasp, axis=-1).min() < 0.05
        q = grasps.mean(0) + 0.8 * drawn.displacement
        i, j = ((q + 1.1) * 256 / 2.2).astype(int)
        assert image[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].any()
        assert np.linalg.norm(drawn.displacement) >= 0.35 * 1.4
        assert release_points(grasps, drawn.displacement).same_side


def test_hands_are_one_to_two() -> None:
    rng = np.random.default_rng(1)
    hands = [draw_hands(rng, SETTINGS) for _ in range(3000)]
    assert abs(hands.count(1) / 3000 - 1 / 3) < 0.03


def test_a_cloth_without_room_gives_none() -> None:
    tiny = SQUARE.flat() * np.float32([0.05, 0.05, 1])
    assert sample(np.random.default_rng(2), tiny, 2, SETTINGS, GRASPING) is None


def test_the_same_seed_draws_the_same() -> None:
    first, second = (sample(np.random.default_rng(5), SQUARE.flat(), 2, SETTINGS, GRASPING) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.vertices == second.vertices
    np.testing.assert_array_equal(first.displacement, second.displacement)

"""Augmented examples describe the same folds: the Cartesian geometry of a manipulation turns with the cloth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.manipulation.geometry import release_points, to_cartesian
from clothkit.manipulation.turns import planar
from clothkit.training.augment import Examples, augment, relabelled, turned
from clothkit.training.pemd import draw, sequences
from tests.crumpled import crumpled

SEQUENCES = sequences(crumpled(6, 0))


def examples(n=2, batch=4):
    return draw(SEQUENCES, n, batch, key=jax.random.key(0))


def releases(mesh, manipulation):
    """Release points [hand, xy], hand by hand, of one manipulation."""
    grasps = jnp.stack([to_cartesian(mesh, manipulation[i : i + 2])[:2] for i in (0, 2)])
    return np.asarray(release_points(grasps, manipulation[4:]).points)


@pytest.mark.parametrize(("angle", "mirrored"), [(0.0, True), (1.0, False), (4.0, True)])
def test_release_points_turn_with_the_cloth_whatever_its_labels(angle, mirrored):
    before = Examples(*(jnp.repeat(a[:1], 8, axis=0) for a in examples()))
    matrix = np.asarray(planar(jnp.float32(angle), jnp.array(mirrored)))
    after = relabelled(turned(before, jnp.broadcast_to(matrix, (8, 2, 2))), jnp.arange(8))
    expected = releases(before.state[0], before.manipulations[0, 0]) @ matrix.T
    for k in range(8):
        np.testing.assert_allclose(releases(after.state[k], after.manipulations[k, 0]), expected, atol=2e-5)
    np.testing.assert_allclose(after.shifts, before.shifts @ matrix.T, atol=1e-6)


def cloud(mesh):
    """A mesh as a set of points, without labels: sorted by height and distance from the middle."""
    points = np.asarray(mesh, np.float64).reshape(-1, 3)
    return np.sort(np.linalg.norm(points[:, :2], axis=1)), np.sort(points[:, 2])


def test_augmented_examples_keep_targets_clean_and_shapes_whole():
    before = examples()
    after = augment(before, noise=0.025, key=jax.random.key(1))
    for i in range(4):
        for one, other in zip(cloud(before.outcomes[i, 1]), cloud(after.outcomes[i, 1]), strict=True):
            np.testing.assert_allclose(one, other, atol=1e-5)
    lengths = [jnp.linalg.norm(e.manipulations[..., 4:], axis=-1) for e in (before, after)]
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=1e-5)


def test_noise_has_its_standard_deviation_and_is_on_the_input_alone():
    clean, noisy = (augment(examples(batch=64), noise=s, key=jax.random.key(2)) for s in (0.0, 0.025))
    np.testing.assert_array_equal(clean.outcomes, noisy.outcomes)
    np.testing.assert_array_equal(clean.manipulations, noisy.manipulations)
    assert abs(float(jnp.std(noisy.state - clean.state)) - 0.025) < 2e-4


def test_both_orders_of_the_grasp_points_and_all_turns_occur():
    same = Examples(*(jnp.repeat(a[:1], 256, axis=0) for a in examples()))
    after = augment(same, noise=0.0, key=jax.random.key(3))
    assert len(np.unique(np.round(after.manipulations[:, 0, :4], 4), axis=0)) == 16
    angles = np.arctan2(after.shifts[:, 0, 1], after.shifts[:, 0, 0])
    assert np.histogram(angles, bins=8, range=(-np.pi, np.pi))[0].min() > 15


def test_drawn_stretches_are_recorded_ones():
    data = crumpled(6, 0)
    data.length[:] = [1, 2, 3, 3, 2, 1]
    data.vertices[0, 2:] = np.nan
    for n in (1, 2, 3):
        drawn = draw(sequences(data), n, 64, key=jax.random.key(n))
        assert np.isfinite(drawn.outcomes).all()
        for i in range(64):
            found = [
                (s, start)
                for s in range(6)
                for start in range(int(data.length[s]) - n + 1)
                if np.array_equal(data.vertices[s, start : start + n + 1][1:], drawn.outcomes[i])
                and np.array_equal(data.manipulation[s, start : start + n], drawn.manipulations[i])
            ]
            assert len(found) == 1
            s, start = found[0]
            np.testing.assert_allclose(
                drawn.shifts[i], np.diff(data.centre[s, start : start + n + 1], axis=0), atol=1e-6
            )

import numpy as np
import pytest
from scipy import stats

from clothkit.cloth.mesh import error
from clothkit.dataset.augment import AugmentConfig, augment
from clothkit.manipulation.vector import SHORTEST

from .test_store import make


def test_variants_are_turned_copies_without_nulls() -> None:
    original = make()
    augmented = augment(original, AugmentConfig(variants=3, null_share=0.0))
    assert len(augmented) == 15
    for row in range(15):
        before, after = original.vertices[row // 3], augmented.vertices[row]
        for axis in (-3, -2):
            np.testing.assert_allclose(
                np.linalg.norm(np.diff(after, axis=axis), axis=-1),
                np.linalg.norm(np.diff(before, axis=axis), axis=-1),
                rtol=1e-3,
            )
        np.testing.assert_array_equal(after[..., 2], before[..., 2])
        # The displacement turns with the cloth: its angle to a vector on the cloth stays, but for a mirror's sign.
        arrows = [v[0, 31, 31, :2] - v[0, 0, 0, :2] for v in (before, after)]
        d0, d1 = original.manipulation[row // 3, 0, 4:], augmented.manipulation[row, 0, 4:]
        np.testing.assert_allclose(d0 @ arrows[0], d1 @ arrows[1], atol=1e-4)
        np.testing.assert_array_equal(augmented.manipulation[row, :, :4], original.manipulation[row // 3, :, :4])
        assert float(np.linalg.norm(after - before)) > 0.1


def test_a_null_leaves_the_state_and_moves_the_rest_on() -> None:
    original = make()
    augmented = augment(original, AugmentConfig(variants=8, null_share=1.0))
    seen = set()
    for row in range(len(augmented)):
        norms = np.linalg.norm(augmented.manipulation[row, :, 4:], axis=-1)
        true = original.manipulation[row // 8]
        same = [s for s in range(3) if float(error(augmented.vertices[row, s], augmented.vertices[row, s + 1])) < 1e-6]
        assert len(same) == 1
        step = same[0]
        seen.add(step)
        assert norms[step] < SHORTEST
        np.testing.assert_array_equal(augmented.centre[row, step], augmented.centre[row, step + 1])
        kept = [s for s in range(3) if s != step]
        np.testing.assert_allclose(augmented.manipulation[row, kept, :4], true[:2, :4])
        assert augmented.length[row] == 3
    assert seen == {0, 1, 2}


def test_nulls_are_drawn_as_decided() -> None:
    """Section 4.6: a displacement uniform in the disc of nulls; grasp points of the manipulation that it displaces, or,
    of every other null, random ones; one hand of a third of these."""
    original = make()
    augmented = augment(original, AugmentConfig(variants=160, null_share=0.5))
    states = augmented.vertices
    same = (states[:, 1:] == states[:, :-1]).all((2, 3, 4))
    assert set(same.sum(1)) == {0, 1}
    row, step = np.nonzero(same)
    assert len(row) / len(same) == pytest.approx(0.5, abs=0.06)
    assert np.bincount(step) / len(step) == pytest.approx(np.full(3, 1 / 3), abs=0.08)
    null, hands = augmented.manipulation[row, step], augmented.hands[row, step]
    squared, angle = (null[:, 4:] ** 2).sum(1) / SHORTEST**2, np.arctan2(null[:, 5], null[:, 4]) / (2 * np.pi) + 0.5
    for uniform in (squared, angle):
        assert stats.kstest(uniform, "uniform").pvalue > 0.01
    displaced = original.manipulation[row // 160, step]
    kept = (null[:, :4] == displaced[:, :4]).all(1)
    assert kept.mean() == pytest.approx(0.5, abs=0.08)
    np.testing.assert_array_equal(hands[kept], original.hands[row // 160, step][kept])
    drawn, of_drawn = null[~kept], hands[~kept]
    single = (drawn[:, :2] == drawn[:, 2:4]).all(1)
    np.testing.assert_array_equal(of_drawn, np.where(single, 1, 2))
    assert single.mean() == pytest.approx(1 / 3, abs=0.1)
    for uniform in (drawn[:, 0], drawn[:, 1], drawn[~single, 2], drawn[~single, 3]):
        assert stats.kstest((uniform + 1) / 2, "uniform").pvalue > 0.01


def test_the_seed_decides() -> None:
    first, second, other = (augment(make(), AugmentConfig(seed=seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.vertices, second.vertices)
    assert (first.vertices != other.vertices).any()


def test_short_sequences_stay_true() -> None:
    original = make()
    original.length[:] = [1, 2, 1, 3, 2]
    missing = np.arange(4) > original.length[:, None]
    original.vertices[missing] = original.centre[missing] = np.nan
    original.manipulation[missing[:, 1:]] = np.nan
    original.hands[missing[:, 1:]] = 0
    augmented = augment(original, AugmentConfig(variants=8, null_share=1.0))
    assert augmented.length.tolist() == np.repeat([2, 3, 2, 3, 3], 8).tolist()
    present = np.arange(4) <= augmented.length[:, None]
    np.testing.assert_array_equal(np.isfinite(augmented.vertices).all((2, 3, 4)), present)
    np.testing.assert_array_equal(np.isfinite(augmented.manipulation).all(2), present[:, 1:])
    np.testing.assert_array_equal(augmented.hands > 0, present[:, 1:])
    for row in np.flatnonzero(augmented.length == 2):
        same = [bool(error(*augmented.vertices[row, s : s + 2]) < 1e-6) for s in range(2)]
        norms = np.linalg.norm(augmented.manipulation[row, :2, 4:], axis=-1)
        assert sum(same) == 1
        assert norms[same.index(True)] < SHORTEST

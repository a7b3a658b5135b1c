"""Convolutions against a brute-force one, XLA's own, and the definition of a transpose."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.models.convolution import convolve, convolve_transposed, glorot

SIZES = st.tuples(*[st.integers(1, 7)] * 3)
STRIDES = st.tuples(*[st.integers(1, 2)] * 3)


def drawn(seed, size, stride, maps=(2, 3), batch=2):
    rng = np.random.default_rng(seed)
    volume = rng.normal(size=(batch, *size, maps[0])).astype(np.float32)
    kernel = rng.normal(size=(*(min(3, n) for n in size), *maps)).astype(np.float32)
    out = tuple(-(-n // s) for n, s in zip(size, stride, strict=True))
    return volume, kernel, rng.normal(size=(batch, *out, maps[1])).astype(np.float32)


def brute_force(volume, kernel, stride):
    """Every product by itself: TensorFlow's SAME, with a kernel cut to the volume."""
    batch, *size, _ = volume.shape
    out = [-(-n // s) for n, s in zip(size, stride, strict=True)]
    low = [max((o - 1) * s + k - n, 0) // 2 for n, s, o, k in zip(size, stride, out, kernel.shape[:3], strict=True)]
    found = np.zeros((batch, *out, kernel.shape[-1]))
    for place in np.ndindex(*out):
        for tap in np.ndindex(*kernel.shape[:3]):
            source = tuple(p * s + t - b for p, s, t, b in zip(place, stride, tap, low, strict=True))
            if all(0 <= i < n for i, n in zip(source, size, strict=True)):
                found[(slice(None), *place)] += volume[(slice(None), *source)] @ kernel[tap]
    return found


@settings(max_examples=10)
@given(SIZES, STRIDES, st.integers(0, 100))
def test_it_is_the_brute_force_convolution(size, stride, seed):
    volume, kernel, _ = drawn(seed, size, stride)
    np.testing.assert_allclose(convolve(volume, kernel, stride), brute_force(volume, kernel, stride), atol=1e-5)


@pytest.mark.parametrize(
    ("size", "stride"),
    [((8, 6, 4), (2, 2, 1)), ((8, 8, 8), (2, 2, 2)), ((2, 2, 2), (2, 2, 2)), ((1, 1, 1), (2, 2, 2))],
)
def test_a_cut_kernel_loses_nothing_that_a_kernel_of_three_has(size, stride):
    """XLA's own, with weights where only the border is that must not matter."""
    volume, kernel, _ = drawn(0, size, stride)
    whole = np.random.default_rng(1).normal(size=(3, 3, 3, *kernel.shape[3:])).astype(np.float32)
    # A volume of two lies under the first two of three weights, a volume of one under the middle one.
    places = np.ix_(*({1: [1], 2: [0, 1]}.get(n, [0, 1, 2]) for n in size))
    whole[places] = kernel
    names = ("NXYZC", "XYZIO", "NXYZC")
    expected = jax.lax.conv_general_dilated(volume, whole, stride, "SAME", dimension_numbers=names)
    np.testing.assert_allclose(convolve(volume, kernel, stride), expected, atol=1e-5)


@settings(max_examples=10)
@given(SIZES, STRIDES, st.integers(0, 100))
def test_the_transpose_has_the_same_inner_products(size, stride, seed):
    """<convolve(x), y> = <x, transposed(y)> for all x and y is what a transpose is."""
    volume, kernel, other = drawn(seed, size, stride)
    there = np.sum(np.asarray(convolve(volume, kernel, stride), np.float64) * other)
    back = convolve_transposed(other, kernel, stride, size)
    assert back.shape == volume.shape
    assert np.sum(np.asarray(back, np.float64) * volume) == pytest.approx(there, abs=1e-3)


def test_batches_may_have_any_dimensions_or_none():
    volume, kernel, other = drawn(0, (4, 4, 4), (2, 2, 2), batch=6)
    expected = convolve(volume, kernel, (2, 2, 2))
    pairs = convolve(volume.reshape(2, 3, *volume.shape[1:]), kernel, (2, 2, 2))
    np.testing.assert_allclose(pairs.reshape(expected.shape), expected, atol=1e-6)
    np.testing.assert_allclose(convolve(jnp.asarray(volume[0]), kernel, (2, 2, 2)), expected[0], atol=1e-6)
    wide = convolve_transposed(other, kernel, (2, 2, 2), (4, 4, 4))
    single = convolve_transposed(other[0], kernel, (2, 2, 2), (4, 4, 4))
    np.testing.assert_allclose(single, wide[0], atol=1e-6)


def test_glorot_counts_a_units_connections():
    """From 8³ voxels by strides of two: 27 weights into a unit from each map, 27 / 8 on average out of it."""
    drawn_weights = np.asarray(glorot((2, 2, 2), (8, 8, 8), 0.5)(jax.random.key(0), (3, 3, 3, 4, 16)))
    limit = 0.5 * np.sqrt(6 / (27 * 4 + 27 / 8 * 16))
    assert np.abs(drawn_weights).max() == pytest.approx(limit, rel=0.01)
    assert drawn_weights.std() == pytest.approx(limit / np.sqrt(3), rel=0.03)
    # One voxel: a dense layer.
    dense = np.asarray(glorot((2, 2, 2), (1, 1, 1))(jax.random.key(0), (1, 1, 1, 40, 60)))
    assert np.abs(dense).max() == pytest.approx(np.sqrt(6 / 100), rel=0.01)

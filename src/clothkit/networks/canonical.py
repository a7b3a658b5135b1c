"""Canonical descriptions: one for all that a turn, a mirror or other labels make of the same cloth.

What happens to a cloth does not depend on where north is, nor on which corner is called the first. A net that is always
shown one and the same of these descriptions need not learn that (Kaba et al., "Equivariance with Learned
Canonicalization Functions", ICML 2023): what augmentation teaches, it is spared.

A mesh is turned or mirrored so that its labels lie as on the flat cloth, as nearly as can be (orthogonal Procrustes).
That leaves eight descriptions; of these it is the one that lies widest along x, with its heavier tails at positive x
and y. A flat cloth is the same in all eight. Voxels can only be turned by right angles: the voxel EM*D sees the one of
these eight; VtM sees voxels that lie widest along x, and is asked about their mirror images, too.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from clothkit.cloth import grid
from clothkit.cloth.equivalents import INVERSE, REVERSE_U, REVERSE_V, SWAP, relabel, relabel_manipulation
from clothkit.cloth.mesh import Mesh, ProbabilisticMesh
from clothkit.manipulation.turns import turn, turn_manipulation, turn_mesh

GRID = np.asarray(grid.flat())[..., :2]
"""Where the vertices of the flat cloth lie [normalised], centred."""

FRAME = 5
"""Numbers in which a frame is written behind a canonical net's latents and traces."""

LEAST_FIT = 1e-5
"""Covariances below it are none: no turn fits better than another, nor does the mirror image."""


class Frame(NamedTuple):
    """How a description becomes the canonical one: turned by `matrix`, then under the labels of equivalent `k`."""

    matrix: Float[Array, "*batch 2 2"]
    k: Int[Array, "*batch"]


def frame(mesh: Mesh) -> Frame:
    """The frame in which a centred mesh [*batch u v 3] is described canonically."""
    fitted = fit(mesh)
    x, y, _ = jnp.moveaxis(turn_mesh(jnp.asarray(mesh), fitted), -1, 0)
    k = eighth(*(jnp.sum(c**n, axis=(-2, -1)) for n in (2, 3) for c in (x, y)))
    return Frame(_product(axes(k), fitted), k)


def fit(mesh: Mesh) -> Float[Array, "*batch 2 2"]:
    """The isometry of the plane that brings a mesh nearest to the flat cloth; the identity where none stands out."""
    flat = jnp.asarray(GRID)
    moment = jnp.einsum("uvi,...uvj->...ij", flat, jnp.asarray(mesh)[..., :2]) / len(GRID) ** 2
    (a, b), (c, d) = ((moment[..., i, 0], moment[..., i, 1]) for i in range(2))
    turning, mirroring = jnp.hypot(a + d, b - c), jnp.hypot(a - d, b + c)
    # Of equals, rounding aside, the turn: a cloth folded in half fits its mirror image as well.
    turns = turning >= mirroring - LEAST_FIT
    length = jnp.maximum(jnp.where(turns, turning, mirroring), LEAST_FIT)
    cos, sin = jnp.where(turns, a + d, a - d) / length, jnp.where(turns, b - c, b + c) / length
    sign = jnp.where(turns, 1.0, -1.0)
    matrix = jnp.stack([jnp.stack([cos, sin], -1), jnp.stack([-sign * sin, sign * cos], -1)], -2)
    return jnp.where((jnp.maximum(turning, mirroring) > LEAST_FIT)[..., None, None], matrix, jnp.eye(2))


def eighth(
    wide_x: Shaped[Array, "*batch"], wide_y: Shaped[Array, "*batch"], tail_x: Array, tail_y: Array
) -> Int[Array, "*batch"]:
    """Which of the eight descriptions is the canonical one, by second and third moments in x and y."""
    swap = wide_y > wide_x
    tail_x, tail_y = jnp.where(swap, tail_y, tail_x), jnp.where(swap, tail_x, tail_y)
    return swap * SWAP + (tail_x < 0) * REVERSE_U + (tail_y < 0) * REVERSE_V


def axes(k: Int[Array, "*batch"]) -> Float[Array, "*batch 2 2"]:
    """What equivalent k does to u and v, done to x and y: the matrix that keeps labels on the flat cloth where they
    were."""
    plain = jnp.where((k & SWAP > 0)[..., None, None], jnp.array([[0.0, 1.0], [1.0, 0.0]]), jnp.eye(2))
    signs = jnp.stack([jnp.where(k & bit, -1.0, 1.0) for bit in (REVERSE_U, REVERSE_V)], axis=-1)
    return signs[..., None] * plain


def _product(a: Float[Array, "*batch 2 2"], b: Float[Array, "*batch 2 2"]) -> Float[Array, "*batch 2 2"]:
    # Written out: products of so many tiny matrices are slow, and on some devices not precise.
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)


def described(mesh: Mesh, frame: Frame) -> Mesh:
    """A mesh [*batch u v 3] as its frame describes it."""
    return relabel(turn_mesh(jnp.asarray(mesh), frame.matrix), frame.k[..., None, None, None])


def manipulation_described(manipulation: Float[Array, "*batch 6"], frame: Frame) -> Float[Array, "*batch 6"]:
    """A manipulation as the frame describes it."""
    return relabel_manipulation(turn_manipulation(manipulation, frame.matrix), frame.k)


def undone(predicted: ProbabilisticMesh, frame: Frame) -> ProbabilisticMesh:
    """A prediction in a frame, as it was described before; also of every n-th vertex, if these are the same under all
    labels. The standard deviations are those along the axes there."""
    k = jnp.asarray(INVERSE)[frame.k][..., None, None, None]
    mean, std = (relabel(part, k) for part in predicted)
    back = jnp.swapaxes(frame.matrix, -1, -2)
    # The variance along an axis of the old description: of a sum of independent ones.
    planar = jnp.sqrt(turn(std[..., :2] ** 2, (back**2)[..., None, None, :, :]))
    return ProbabilisticMesh(turn_mesh(mean, back), jnp.concatenate([planar, std[..., 2:]], axis=-1))


def shift_undone(shift: Float[Array, "*batch 2"], frame: Frame) -> Float[Array, "*batch 2"]:
    """A centre shift in a frame, as it was described before."""
    return turn(shift, jnp.swapaxes(frame.matrix, -1, -2))


def voxel_frame(voxels: Shaped[Array, "*batch x y z"]) -> Frame:
    """The frame in which centred voxels are described canonically, of the eight that right angles and mirrors make."""
    k = eighth(*_moments(voxels, 2), *_moments(voxels, 3))
    return Frame(axes(k), k)


def _moments(
    voxels: Shaped[Array, "*batch x y z"], power: int
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Of what voxels cover seen from above, along x and along y, about the middle, [*batch] each."""
    seen = jnp.any(voxels > 0, axis=-1)
    x, y = (jnp.arange(side) - (side - 1) / 2 for side in seen.shape[-2:])
    return jnp.einsum("...xy,x->...", seen, x**power), jnp.einsum("...xy,y->...", seen, y**power)


def voxels_described(voxels: Shaped[Array, "*batch x y z"], frame: Frame) -> Shaped[Array, "*batch x y z"]:
    """Voxels, or any array over them, as their frame describes them."""
    return relabel(voxels, frame.k[..., None, None, None])


def voxels_undone(voxels: Shaped[Array, "*batch x y z"], frame: Frame) -> Shaped[Array, "*batch x y z"]:
    """The opposite of `voxels_described`."""
    return relabel(voxels, jnp.asarray(INVERSE)[frame.k][..., None, None, None])


def cartesian_described(manipulation: Float[Array, "*batch 6"], frame: Frame) -> Float[Array, "*batch 6"]:
    """A manipulation with Cartesian grasp points as the frame describes it."""
    points = manipulation.reshape(*manipulation.shape[:-1], 3, 2)
    return turn(points, frame.matrix[..., None, :, :]).reshape(manipulation.shape)


def framed(units: Float[Array, "*batch units"], found: Frame) -> Float[Array, "*batch units_and_frame"]:
    """A latent or a trace with the frame that it is in."""
    matrix = jnp.broadcast_to(found.matrix, (*units.shape[:-1], 2, 2)).reshape(*units.shape[:-1], 4)
    k = jnp.broadcast_to(found.k, units.shape[:-1])[..., None]
    return jnp.concatenate([units, matrix, k.astype(units.dtype)], axis=-1)


def unframed(latent: Float[Array, "*batch units_and_frame"]) -> tuple[Float[Array, "*batch units"], Frame]:
    """The opposite of `framed`."""
    matrix = latent[..., -FRAME:-1].reshape(*latent.shape[:-1], 2, 2)
    return latent[..., :-FRAME], Frame(matrix, latent[..., -1].astype(jnp.int32))


def trace_within(
    trace: Float[Array, "*batch units_and_frame"], latent: Float[Array, "*batch units_and_frame"]
) -> Float[Array, "*batch units"]:
    """A trace without its frame; zero if that is not the latent's."""
    same = jnp.all(trace[..., -FRAME:] == latent[..., -FRAME:], axis=-1, keepdims=True)
    return jnp.where(same, trace[..., :-FRAME], 0)


def lies_along_y(voxels: Bool[Array, "*batch x y z"]) -> Bool[Array, "*batch"]:
    """Whether voxels, seen from above, lie wider along y than along x."""
    along_x, along_y = _moments(voxels, 2)
    return along_y > along_x

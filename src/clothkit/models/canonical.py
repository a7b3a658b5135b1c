"""Canonical descriptions: rotated, mirrored and relabelled versions of one cloth state are mapped to a single one.

The behaviour of a cloth depends neither on its orientation about z nor on which corner is labelled as the first. A net
whose input is always the canonical description need not learn this from augmentation (Kaba et al., "Equivariance with
Learned Canonicalization Functions", ICML 2023).

A mesh is rotated or mirrored to bring its vertices as close as possible to those of the flat cloth (orthogonal
Procrustes). Eight descriptions, one for each equivalent, remain possible. The canonical one has its larger second
moment along x, and third moments in x and y that are not negative. For a flat cloth all eight are equal. Voxels can be
rotated by right angles and mirrored only: the input of the voxel EM*D is the canonical one of these eight versions. The
input of VtM has its larger second moment along x; mirrored versions are covered by `vtm.Views`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, Shaped

from clothkit.cloth.mesh import Cloth, Mesh, ProbabilisticMesh
from clothkit.cloth.symmetry import relabel, relabel_cloth, relabel_manipulation
from clothkit.cloth.topology import CLOTH_LENGTH, PAPERS_CLOTH, REVERSE_U, REVERSE_V, SQUARE, SWAP
from clothkit.manipulation.turns import turn, turn_manipulation, turn_mesh

if TYPE_CHECKING:
    from clothkit.models.forward import ForwardModel

GRID = np.asarray(SQUARE.flat())[..., :2]
"""Positions xy of the flat cloth's vertices [normalised], centred."""

FRAME = 5
"""Number of components that encode the frame; they are appended to a canonical net's latents and memory traces."""

LEAST_FIT = 1e-5
"""Threshold below which covariances, and differences between them, are treated as zero in `fit`."""


class Frame(NamedTuple):
    """The transformation to a canonical description: `matrix` is applied to x and y, then equivalent `k`."""

    matrix: Float[Array, "*batch 2 2"]
    k: Int[Array, "*batch"]


def frame(mesh: Mesh, cloth: Cloth = PAPERS_CLOTH) -> Frame:
    """The transformation of a centred mesh [*batch u v 3] to its canonical description."""
    fitted = fit(mesh, cloth)
    x, y, _ = jnp.moveaxis(turn_mesh(jnp.asarray(mesh), fitted), -1, 0)
    k = eighth(*(jnp.sum(c**n, axis=(-2, -1)) for n in (2, 3) for c in (x, y)))
    return Frame(_product(axes(k), fitted), k)


def fit(mesh: Mesh, cloth: Cloth = PAPERS_CLOTH) -> Float[Array, "*batch 2 2"]:
    """The rotation or reflection of the plane that brings a mesh nearest to the flat cloth with these sides.

    It is the identity if no isometry fits better than the others.
    """
    flat = jnp.asarray(GRID)
    moment = jnp.einsum("uvi,...uvj->...ij", flat, jnp.asarray(mesh)[..., :2]) / len(GRID) ** 2
    # A side of the flat cloth stretches one row.
    moment = moment * (jnp.asarray(cloth)[..., :2, None] / CLOTH_LENGTH)
    (a, b), (c, d) = ((moment[..., i, 0], moment[..., i, 1]) for i in range(2))
    turning, mirroring = jnp.hypot(a + d, b - c), jnp.hypot(a - d, b + c)
    # A cloth folded in half fits its mirror image equally well: the margin selects the rotation despite rounding.
    turns = turning >= mirroring - LEAST_FIT
    length = jnp.maximum(jnp.where(turns, turning, mirroring), LEAST_FIT)
    cos, sin = jnp.where(turns, a + d, a - d) / length, jnp.where(turns, b - c, b + c) / length
    sign = jnp.where(turns, 1.0, -1.0)
    matrix = jnp.stack([jnp.stack([cos, sin], -1), jnp.stack([-sign * sin, sign * cos], -1)], -2)
    return jnp.where((jnp.maximum(turning, mirroring) > LEAST_FIT)[..., None, None], matrix, jnp.eye(2))


def frame_of_square(mesh: Mesh, _: Cloth = PAPERS_CLOTH) -> Frame:
    """`frame`, whatever the cloth's sides are."""
    return frame(mesh)


def eighth(
    wide_x: Shaped[Array, "*batch"], wide_y: Shaped[Array, "*batch"], tail_x: Array, tail_y: Array
) -> Int[Array, "*batch"]:
    """Index k of the canonical one among the eight descriptions, from the second and third moments in x and y."""
    swap = wide_y > wide_x
    tail_x, tail_y = jnp.where(swap, tail_y, tail_x), jnp.where(swap, tail_x, tail_y)
    return swap * SWAP + (tail_x < 0) * REVERSE_U + (tail_y < 0) * REVERSE_V


def axes(k: Int[Array, "*batch"]) -> Float[Array, "*batch 2 2"]:
    """The matrix that applies to x and y what equivalent k applies to u and v.

    Relabelling a flat cloth by k and transforming it by this matrix leaves it unchanged.
    """
    plain = jnp.where((k & SWAP > 0)[..., None, None], jnp.array([[0.0, 1.0], [1.0, 0.0]]), jnp.eye(2))
    signs = jnp.stack([jnp.where(k & bit, -1.0, 1.0) for bit in (REVERSE_U, REVERSE_V)], axis=-1)
    return signs[..., None] * plain


def _product(a: Float[Array, "*batch 2 2"], b: Float[Array, "*batch 2 2"]) -> Float[Array, "*batch 2 2"]:
    # A sum of products, because `matmul` is slow for many tiny matrices, and not precise on some devices.
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)


def described(mesh: Mesh, frame: Frame) -> Mesh:
    """A mesh [*batch u v 3], transformed to the canonical description."""
    return relabel(turn_mesh(jnp.asarray(mesh), frame.matrix), frame.k[..., None, None, None])


def manipulation_described(manipulation: Float[Array, "*batch 6"], frame: Frame) -> Float[Array, "*batch 6"]:
    """A manipulation with geodesic grasp points, transformed to the canonical description."""
    return relabel_manipulation(turn_manipulation(manipulation, frame.matrix), frame.k)


def undone(predicted: ProbabilisticMesh, frame: Frame) -> ProbabilisticMesh:
    """A prediction, transformed from the canonical description back to the original one.

    The standard deviations of the result are those along the original axes, if coordinates are independent. Predictions
    may be thinned, provided that the same vertices are kept under all labels, as `topology.thinned` does.
    """
    k = jnp.asarray(SQUARE.inverses)[frame.k][..., None, None, None]
    mean, std = (relabel(part, k) for part in predicted)
    back = jnp.swapaxes(frame.matrix, -1, -2)
    # The variance of a weighted sum of independent coordinates.
    planar = jnp.sqrt(turn(std[..., :2] ** 2, (back**2)[..., None, None, :, :]))
    return ProbabilisticMesh(turn_mesh(mean, back), jnp.concatenate([planar, std[..., 2:]], axis=-1))


def shift_undone(shift: Float[Array, "*batch 2"], frame: Frame) -> Float[Array, "*batch 2"]:
    """A centre shift, transformed from the canonical description back to the original one."""
    return turn(shift, jnp.swapaxes(frame.matrix, -1, -2))


def voxel_frame(voxels: Shaped[Array, "*batch x y z"], _: Cloth = PAPERS_CLOTH) -> Frame:
    """The transformation of centred voxels to their canonical description, one of eight by right angles and mirrors.

    It does not depend on the cloth's sides.
    """
    k = eighth(*_moments(voxels, 2), *_moments(voxels, 3))
    return Frame(axes(k), k)


def _moments(
    voxels: Shaped[Array, "*batch x y z"], power: int
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Moments of order `power`, along x and along y, of the columns that hold cloth, about the grid's middle.

    `[*batch]` each.
    """
    seen = jnp.any(voxels > 0, axis=-1)
    x, y = (jnp.arange(side) - (side - 1) / 2 for side in seen.shape[-2:])
    return jnp.einsum("...xy,x->...", seen, x**power), jnp.einsum("...xy,y->...", seen, y**power)


def voxels_described(voxels: Shaped[Array, "*batch x y z"], frame: Frame) -> Shaped[Array, "*batch x y z"]:
    """Voxels, or any array over them, transformed to the canonical description."""
    return relabel(voxels, frame.k[..., None, None, None])


def voxels_undone(voxels: Shaped[Array, "*batch x y z"], frame: Frame) -> Shaped[Array, "*batch x y z"]:
    """The inverse of `voxels_described`."""
    return relabel(voxels, jnp.asarray(SQUARE.inverses)[frame.k][..., None, None, None])


def cartesian_described(manipulation: Float[Array, "*batch 6"], frame: Frame) -> Float[Array, "*batch 6"]:
    """A manipulation with Cartesian grasp points, transformed to the canonical description."""
    points = manipulation.reshape(*manipulation.shape[:-1], 3, 2)
    return turn(points, frame.matrix[..., None, :, :]).reshape(manipulation.shape)


def framed(units: Float[Array, "*batch units"], found: Frame) -> Float[Array, "*batch units_and_frame"]:
    """A latent or a memory trace with the frame that it refers to appended."""
    matrix = jnp.broadcast_to(found.matrix, (*units.shape[:-1], 2, 2)).reshape(*units.shape[:-1], 4)
    k = jnp.broadcast_to(found.k, units.shape[:-1])[..., None]
    return jnp.concatenate([units, matrix, k.astype(units.dtype)], axis=-1)


def unframed(latent: Float[Array, "*batch units_and_frame"]) -> tuple[Float[Array, "*batch units"], Frame]:
    """The inverse of `framed`: the latent without its frame, and the frame."""
    matrix = latent[..., -FRAME:-1].reshape(*latent.shape[:-1], 2, 2)
    return latent[..., :-FRAME], Frame(matrix, latent[..., -1].astype(jnp.int32))


def trace_within(
    trace: Float[Array, "*batch units_and_frame"], latent: Float[Array, "*batch units_and_frame"]
) -> Float[Array, "*batch units"]:
    """A memory trace without its frame, replaced by zeros if its frame differs from the latent's."""
    same = jnp.all(trace[..., -FRAME:] == latent[..., -FRAME:], axis=-1, keepdims=True)
    return jnp.where(same, trace[..., :-FRAME], 0)


def lies_along_y(voxels: Bool[Array, "*batch x y z"]) -> Bool[Array, "*batch"]:
    """Whether the columns that hold cloth have a larger second moment along y than along x."""
    along_x, along_y = _moments(voxels, 2)
    return along_y > along_x


@dataclass(frozen=True)
class Description:
    """How the states of one representation are transformed to canonical descriptions, and predictions back."""

    frame: Callable[..., Frame]
    """states [*b *state], cloths [*b 3] -> the transformations to their canonical descriptions"""
    state: Callable[..., Any]
    """states, frames -> the states, transformed"""
    manipulation: Callable[..., Any]
    """manipulations [*b 6], frames -> the manipulations, transformed"""
    undone: Callable[..., Any]
    """predictions, frames -> the predictions, transformed back"""


MESHES = Description(frame, described, manipulation_described, undone)
"""Of meshes, for nets that are told a cloth's sides; grasp points are geodesic."""

MESHES_OF_SQUARES = replace(MESHES, frame=frame_of_square)
"""Of meshes, for nets that are not told a cloth's sides, and so are not shown them by the frame either."""

VOXELS = Description(voxel_frame, voxels_described, cartesian_described, voxels_undone)
"""Of voxels; grasp points are Cartesian."""


@dataclass(frozen=True)
class Canonicalised:
    """A `ForwardModel` that shows another one canonical descriptions only.

    A state's frame is appended to its latents and memory traces. So manipulations, predictions and centre shifts are in
    the coordinates and labels of the state that was encoded.
    """

    model: "ForwardModel"
    description: Description

    def encode(self, params: PyTree, state: Any, cloth: Cloth = PAPERS_CLOTH) -> Float[Array, "*batch units_and_frame"]:
        """The latent of a state's canonical description: eq. (2)."""
        state = jnp.asarray(state)
        found = self.description.frame(state, cloth)
        shown = self.description.state(state, found)
        return framed(self.model.encode(params, shown, relabel_cloth(cloth, found.k)), found)

    def step(
        self, params: PyTree, latent: Any, trace: Any, manipulation: Any
    ) -> tuple[
        Float[Array, "*batch units_and_frame"], Float[Array, "*batch units_and_frame"], Float[Array, "*batch 2"]
    ]:
        """Latent, memory trace and centre shift [normalised] after one manipulation: eq. (3).

        A trace that refers to another frame than the latent's is replaced by zeros.
        """
        latent, trace, manipulation = map(jnp.asarray, (latent, trace, manipulation))
        units, found = unframed(latent)
        shown = self.description.manipulation(manipulation, found)
        units, left, shift = self.model.step(params, units, trace_within(trace, latent), shown)
        return framed(units, found), framed(left, found), shift_undone(shift, found)

    def shown(self, latent: Any, manipulation: Any) -> tuple[Float[Array, "*batch units"], Float[Array, "*batch 6"]]:
        """Latent and manipulation as M is shown them: in the canonical description, without the frame."""
        units, found = unframed(jnp.asarray(latent))
        return units, self.description.manipulation(jnp.asarray(manipulation), found)

    def decode(self, params: PyTree, latent: Any, stride: int = 1) -> Any:
        """The prediction for a latent: eq. (4)."""
        units, found = unframed(jnp.asarray(latent))
        return self.description.undone(self.model.decode(params, units, stride), found)

"""Planning in voxels, for baselines B4 and B5: the voxel EM*D and its losses (section 6.3, design 6.15).

Grasp points are Cartesian, relative to the centre of the state that is manipulated. Voxels have no labels and are not
whitened. A prediction consists of the logits of occupancy.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped

from clothkit.models import emd_voxel
from clothkit.models.net import Net
from clothkit.planning.forward import Forward
from clothkit.planning.loss import Range

Logits = Float[Array, "*batch x y z"]


def decode(net: Net, latent: Float[Array, "*batch latent"], every: int) -> Logits:
    """The logits of all voxels. `every` is ignored: the decoder always computes the whole volume."""
    return emd_voxel.logits(net, latent)


def alone(state: Shaped[Array, "*state"]) -> Shaped[Array, "1 *state"]:
    """The state with a leading axis of length 1, since voxels have one labelling only."""
    return jnp.asarray(state)[None]


def as_it_is(prediction: Logits, k: Int[Array, ""]) -> Logits:
    """The prediction unchanged, since voxels have no labels."""
    return prediction


def points(state: Shaped[Array, "x y z"], grasps: Float[Array, "*points 2"]) -> Float[Array, "*points 2"]:
    """The grasp points unchanged: they are Cartesian already [normalised]."""
    return grasps


def target(goals: Shaped[Array, "*goals x y z"]) -> Float[Array, "*goals x y z"]:
    """Occupancy as floats, 0 or 1."""
    return jnp.asarray(goals, jnp.float32)


def whole(goals: Shaped[Array, "*goals x y z"], every: int) -> Shaped[Array, "*goals x y z"]:
    """The goals unchanged: losses always compare all voxels."""
    return goals


def accuracy(goal: Float[Array, "*#batch x y z"], outcome: Logits, span: Range | None = None) -> Float[Array, "*batch"]:
    """An accuracy term of eq. (13) with the binary cross-entropy in place of the NLL."""
    loss = emd_voxel.cross_entropy(outcome, goal)
    return loss if span is None else (loss - span.low) / (span.high - span.low)


def accuracy_of_each(
    goals: Float[Array, "goals x y z"], outcome: Logits, span: Range | None = None
) -> Float[Array, "strains goals"]:
    """`accuracy` of every outcome of a batch for every one of several goals."""
    return jnp.stack([accuracy(goal, outcome, span) for goal in goals], axis=-1)


def diff(a: Logits, b: Logits) -> Float[Array, "*batch"]:
    """diff of eq. (15) for voxels: the mean squared difference of the predicted occupancies."""
    return jnp.mean((jax.nn.sigmoid(a) - jax.nn.sigmoid(b)) ** 2, axis=(-3, -2, -1))


VOXEL = Forward(
    emd_voxel.encode,
    emd_voxel.step,
    decode,
    labels=1,
    equivalents=alone,
    relabelled=as_it_is,
    points=points,
    target=target,
    thinned=whole,
    accuracy=accuracy,
    accuracy_of_each=accuracy_of_each,
    diff=diff,
)

"""Random plans on the data's support: like those that were recorded, as far as the nets can tell (section 4.4).

First manipulations satisfy the fold restriction on the observed state, later ones on the state that a net predicts:
hands grasp at the cloth's edge, and q lies on the cloth. For meshes only.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from clothkit.manipulation.draws import random_manipulations
from clothkit.manipulation.vector import SHORTEST
from clothkit.models.forward import ForwardModel
from clothkit.planning.initial import FOLD_POINT, random_plans
from clothkit.planning.representation import Representation
from clothkit.planning.types import Problem


def supported_plans(
    model: ForwardModel,
    representation: Representation,
    net: Any,
    problem: Problem,
    *,
    count: int,
    length: int,
    key: PRNGKeyArray,
) -> Float[Array, "plans n 6"]:
    """Draw plans for one problem, in the labels of its state; `net` predicts where the cloth will lie."""
    key_first, key_later = jax.random.split(key)
    xy = representation.points(problem.state, jnp.asarray(problem.candidates.grasps))
    assert problem.covered is not None, "what the cloth covers"
    first = random_plans(count, 1, problem.candidates, xy, covered=problem.covered, key=key_first)[:, 0]
    steps, latent = [first], model.encode(net, problem.state, problem.cloth)
    latent, trace = (jnp.broadcast_to(part, (count, *part.shape)) for part in (latent, problem.traces[0][0]))
    for own in jax.random.split(key_later, length - 1):
        latent, trace, _ = model.step(net, latent, trace, steps[-1])
        steps.append(_later(representation, model.decode(net, latent).mean, own))
    return jnp.stack(steps, axis=1)


def _later(
    representation: Representation, states: Float[Array, "plans u v 3"], key: PRNGKeyArray
) -> Float[Array, "plans 6"]:
    key_grasps, key_q = jax.random.split(key)
    grasps = random_manipulations((len(states),), edge=1.0, key=key_grasps)[:, :4]
    places = jax.vmap(representation.points)(states, grasps.reshape(-1, 2, 2))
    vertices = states.reshape(len(states), -1, 3)[..., :2]
    chosen = jax.random.randint(key_q, (len(states), 1, 1), 0, vertices.shape[1])
    q = jnp.take_along_axis(vertices, chosen, axis=1)[:, 0]
    displacement = (q - places.mean(-2)) / FOLD_POINT
    length = jnp.linalg.norm(displacement, axis=-1, keepdims=True)
    # A null manipulation is made as long as the shortest that is none.
    longer = jnp.maximum(1.0, 1.01 * SHORTEST / jnp.maximum(length, 1e-6))
    return jnp.concatenate([grasps, displacement * longer], axis=-1)

"""The search for a plan: an optimiser looks for the plan of the lowest objective (section 5.1).

`search` is compiled once per plan length, for all batches of tasks of that length.
"""

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Gt, Le, Predicate
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, Shaped

from clothkit.cloth.symmetry import relabel_manipulation_batch
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.draws import SINGLE_SHARE
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import is_null, is_single
from clothkit.models.forward import ForwardModel, predict
from clothkit.planning import objective as objectives
from clothkit.planning.initial import folds, random_plans, snap
from clothkit.planning.objective import Objective, Outlook, fix
from clothkit.planning.optimisers import AnySettings, optimise
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.optimisers.space import Evaluation, Initial, Plans, Space
from clothkit.planning.representation import Representation
from clothkit.planning.support import supported_plans
from clothkit.planning.types import Found, Problem
from clothkit.runtime.config import config


@config
class SearchConfig:
    """How plans are searched for; the defaults are the paper's."""

    optimiser: AnySettings = GradientConfig()
    """The optimiser by name, and its settings."""
    stride: Annotated[int, Gt(0), Predicate(lambda stride: SQUARE.shape[0] % stride == 0)] = 1
    """Stride along u and v of the vertices that the optimiser's losses compare; the final choice of a plan uses all.
    For meshes only."""
    fold: bool = False
    """Whether first manipulations must have q on the cloth, as in the training data (section 4.4), or be null."""
    edge: Annotated[float, Ge(0), Le(1)] = 0.0
    """Share of later grasp points of random plans that lie on the cloth's edge, half of them at its corners. A camera
    sees a cloth's outline, where hands grasp, and most of an outline is edge. For meshes only."""
    one_handed: Annotated[float, Ge(0), Le(1)] = SINGLE_SHARE
    """Share of one-handed manipulations in random plans. With 0, all plans are two-handed, but where there is a single
    point to grasp."""


@partial(jax.jit, static_argnames=("model", "representation", "settings", "length", "evaluation"))
def search(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    problems: Problem,
    objective: Objective,
    *,
    length: int,
    settings: SearchConfig,
    keys: Shaped[PRNGKeyArray, " tasks"],
    evaluation: Callable[..., objectives.Evaluation] = objectives.evaluate,
) -> Found:
    """Search for the best plan of each problem of a batch; every field of `problems` has a leading axis of tasks.

    `keys` has one key per task, so that a task's result does not depend on the other tasks of the batch. `evaluation`
    evaluates plans as `objective.evaluate` does, which asks for their last states alone.
    """

    def one(problem: Problem, key: PRNGKeyArray) -> Found:
        problem = jax.tree.map(jnp.asarray, problem)
        fixed = fix(model, representation, nets, problem)
        posed = posed_objective(objective, model, representation, nets, problem, length, key)

        def evaluate(plans: Plans, *, steps: Array | None = None, exact: bool = False) -> Evaluation:
            common, relative = plans.labels
            found = evaluation(
                posed,
                model,
                representation,
                nets,
                fixed,
                relabel_manipulation_batch(plans.plan, common),
                common,
                relative,
                stride=1 if exact else settings.stride,
                steps=steps,
            )
            return Evaluation(found.loss, (common, found.relative), found.terms)

        space = space_of(representation, problem, length, settings)
        initial = carried_plans(representation, problem)
        found = optimise(evaluate, space, settings.optimiser, initial=initial, key=key)
        common, relative = found.labels
        return Found(found.plan, found.loss, found.terms, common, relative, found.losses)

    return jax.vmap(one)(problems, keys)


def posed_objective(
    objective: Objective,
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    problem: Problem,
    length: int,
    key: PRNGKeyArray,
) -> Objective:
    """The objective for one problem, posed with plans on its support where a term needs them."""
    if not objective.draws:
        return objective
    # Another key than the search's, so that it draws what it draws without such a term.
    key = jax.random.fold_in(key, objective.draws)
    plans = supported_plans(model, representation, nets[0], problem, count=objective.draws, length=length, key=key)
    states, cloth = jnp.broadcast_to(problem.state, (len(plans), *problem.state.shape)), problem.cloth
    found = [
        predict(model, net, states, plans, jnp.broadcast_to(trace[0], (len(plans), trace.shape[-1])), cloth=cloth)[0]
        for net, trace in zip(nets, problem.traces, strict=True)
    ]
    return objective.posed(Outlook(representation, plans, tuple(found)))


@partial(jax.jit, static_argnames=("model", "representation"))
def evaluated(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    problems: Problem,
    objective: Objective,
    plan: Float[Array | np.ndarray, "tasks n 6"],
    relative: Int[Array | np.ndarray, " tasks"],
    keys: Shaped[PRNGKeyArray, " tasks"],
) -> Found:
    """Plans that nobody searched for as a search would return them, found in the labels of their states.

    `relative` are the relabellings of the goals that their losses refer to. `keys` are those of the searches that the
    plans are compared with, so that a term that is posed with plans is posed with the same ones.
    """

    def one(problem: Problem, plan: Array, relative: Array, key: PRNGKeyArray) -> Found:
        problem = jax.tree.map(jnp.asarray, problem)
        fixed, common = fix(model, representation, nets, problem), jnp.zeros((), jnp.int32)
        posed = posed_objective(objective, model, representation, nets, problem, plan.shape[0], key)
        found = objectives.evaluate(posed, model, representation, nets, fixed, plan[None], common[None], relative[None])
        loss, terms = found.loss[0], {name: term[0] for name, term in found.terms.items()}
        return Found(plan, loss, terms, common, relative, found.loss[None])

    return jax.vmap(one)(problems, jnp.asarray(plan), jnp.asarray(relative, jnp.int32), keys)


def space_of(representation: Representation, problem: Problem, length: int, settings: SearchConfig) -> Space:
    """The plans among which to search for one problem, in the labels of its state.

    A plan's labels are the index of the common equivalent in which it is evaluated, and that of the goal's relabelling
    (design 6.10). Random plans get random common equivalents in the first search of a session, and in turn in later
    ones. With `settings.fold`, first manipulations must satisfy the fold restriction of the training data.
    """
    xy = representation.points(problem.state, jnp.asarray(problem.candidates.grasps))

    def sample(count: int, *, draws: int = 1, key: PRNGKeyArray) -> Plans:
        key_plan, key_common = jax.random.split(key)
        rows = count * draws
        drawn = jax.random.randint(key_common, (rows,), 0, representation.labels)
        common = jnp.where(problem.later, jnp.arange(rows) // draws % representation.labels, drawn)
        plan = random_plans(
            rows,
            length,
            problem.candidates,
            xy,
            covered=problem.covered if settings.fold else None,
            edge=settings.edge,
            one_handed=settings.one_handed,
            key=key_plan,
        )
        return Plans(plan, (common, jnp.full(rows, problem.relative)))

    def valid(plans: Plans) -> Bool[Array, " plans"]:
        """Mask of the plans whose first manipulation is like those in the training data, or null.

        In others, the hands lie on different sides of the line m or, with `fold`, q lies off the cloth. The nets were
        not trained on these, so their predictions are not trusted. Without one-handed manipulations, both hands need a
        point of their own, too, which candidates near those of a carried plan may not leave them.
        """
        first = plans.plan[:, 0]
        grasps = representation.points(problem.state, first[:, :4].reshape(-1, 2, 2))
        like_data = jnp.asarray(release_points(grasps, first[:, 4:]).same_side) | is_null(first)
        if settings.fold:
            assert problem.covered is not None, "a search with `fold` is told what the cloth covers"
            like_data &= folds(problem.covered, grasps, first)
        if settings.one_handed == 0:
            like_data &= ~is_single(first) | (problem.candidates.present < 2)
        return like_data

    def variants(plans: Plans) -> Plans:
        count, labels = len(plans.plan), representation.labels
        repeated = jax.tree.map(lambda leaf: jnp.repeat(leaf, labels, axis=0), plans)
        return repeated._replace(labels=(jnp.tile(jnp.arange(labels), count), repeated.labels[1]))

    return Space(length, problem.candidates.grasps, problem.candidates.present, sample, valid, variants)


def carried_plans(representation: Representation, problem: Problem) -> Initial:
    """The rest of the previous plan, once in each common equivalent, to begin a later search of a session with.

    Its first grasp points are replaced by the nearest candidates. In the first search no row is given.
    """
    carried, labels = jnp.asarray(problem.carried), representation.labels
    wanted = representation.points(problem.state, carried[0, :4].reshape(2, 2))
    xy = representation.points(problem.state, jnp.asarray(problem.candidates.grasps))
    first = snap(carried[0], wanted, problem.candidates, xy)
    plan = jnp.broadcast_to(jnp.concatenate([first[None], carried[1:]]), (labels, *carried.shape))
    plans = Plans(plan, (jnp.arange(labels), jnp.full(labels, problem.relative)))
    return Initial(plans, jnp.broadcast_to(problem.later, (labels,)))

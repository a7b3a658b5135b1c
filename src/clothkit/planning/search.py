"""The search for a plan: gradient descent through the forward models, with many strains in parallel (section 5.1).

`search` is compiled once per plan length, for all batches of tasks of that length. During the search, each strain's
plan is in the labels of the strain's common equivalent; the returned plan is in the labels of the initial state.
"""

from functools import partial
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
from annotated_types import Ge, Gt, Le, MultipleOf, Predicate
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, Shaped

from clothkit.cloth.equivalents import COUNT, INVERSE, relabel_manipulation, relabel_manipulation_batch
from clothkit.cloth.grid import SIDE
from clothkit.config import config
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import is_null, is_single
from clothkit.models.forward import ForwardModel
from clothkit.planning.initial import folds, random_plans, snap
from clothkit.planning.irprop import IRpropConfig, irprop_minus
from clothkit.planning.objective import Objective, evaluate, fix
from clothkit.planning.representation import Representation
from clothkit.planning.types import Found, Problem

NEAR = 0.15
"""Standard deviation of the noise added to the best plan when a strain restarts near it [geodesic, or normalised]."""


@config
class SearchConfig:
    """Size and restart rules of a search; the defaults are the paper's."""

    strains: Annotated[int, Gt(0), MultipleOf(COUNT)] = 256
    base_iterations: Annotated[int, Ge(0)] = 25
    iterations_per_step: Annotated[int, Ge(0)] = 25
    screen: Annotated[int, Gt(0)] = 1
    """Random plans drawn for each strain's first start, of which the one of lowest loss is used. Needs no gradients."""
    patience: Annotated[int, Gt(0)] = 5
    """Iterations without improvement after which a strain restarts."""
    every: Annotated[int, Gt(0), Predicate(lambda every: SIDE % every == 0)] = 1
    """Stride along u and v of the vertices in the strains' losses; the final choice of a plan uses all vertices."""
    fold: bool = False
    """Whether first manipulations must have q on the cloth, as in the training data (section 4.4), or be null."""
    near: Annotated[float, Ge(0), Le(1)] = 0.0
    """Share of the restarts that begin near the best plan so far, instead of at a random plan."""
    irprop: IRpropConfig = IRpropConfig()

    def iterations(self, length: int) -> int:
        """Number of iterations in a search for plans of this length; each evaluates every strain's loss once."""
        return self.base_iterations + self.iterations_per_step * length


class _Strains(NamedTuple):
    """The state of all strains; every field has a row per strain."""

    plan: Float[Array, "strains n 6"]
    single: Bool[Array, "strains n"]
    grasps: Float[Array, "strains 2 2"]
    """Positions of the first grasp points, xy [normalised]."""
    common: Int[Array, " strains"]
    relative: Int[Array, " strains"]
    rate: Float[Array, "strains n 6"]
    gradient: Float[Array, "strains n 6"]
    lowest: Float[Array, " strains"]
    stale: Int[Array, " strains"]


class _Best(NamedTuple):
    plan: Float[Array, "strains n 6"]
    common: Int[Array, " strains"]
    relative: Int[Array, " strains"]
    loss: Float[Array, " strains"]


class _State(NamedTuple):
    strains: _Strains
    best: _Best
    restart: Bool[Array, " strains"]
    """Which strains restart before the next iteration."""


@partial(jax.jit, static_argnames=("model", "representation", "settings", "length"))
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
) -> Found:
    """Search for the best plan of each problem of a batch; every field of `problems` has a leading axis of tasks.

    `keys` has one key per task, so that a task's result does not depend on the other tasks of the batch.
    """
    solve = partial(_search_one, model, representation, nets, objective, length, settings)
    return jax.vmap(solve)(problems, keys)


def _search_one(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    objective: Objective,
    length: int,
    settings: SearchConfig,
    problem: Problem,
    key: PRNGKeyArray,
) -> Found:
    fixed = fix(model, representation, nets, problem)
    losses_of = partial(evaluate, objective, model, representation, nets, fixed)

    def total(plan: Array, common: Array, relative: Array) -> tuple[Array, tuple[Array, Array]]:
        found = losses_of(plan, common, relative, stride=settings.every)
        return jnp.sum(found.loss), (found.loss, found.relative)

    def iterate(state: _State, key: PRNGKeyArray) -> tuple[_State, tuple[Array, Array]]:
        key_fresh, key_near = jax.random.split(key)
        fresh = _start(representation, problem, length, settings, key=key_fresh)
        if settings.near:
            fresh = _some_near(representation, state.best, fresh, problem, settings, key=key_near)
        strains = _choose(state.restart, fresh, state.strains)
        gradient, (loss, relative) = jax.grad(total, has_aux=True)(strains.plan, strains.common, strains.relative)
        strange = _strange(strains, problem, settings)
        loss = jnp.where(strange, jnp.inf, loss)
        now = _Best(strains.plan, strains.common, relative, loss)
        best = _choose(loss < state.best.loss, now, state.best)
        stale = jnp.where(loss < strains.lowest, 0, strains.stale + 1)
        restart = strange | (stale >= settings.patience)
        strains = _move(strains, gradient, settings.irprop)
        strains = strains._replace(lowest=jnp.minimum(loss, strains.lowest), stale=stale)
        return _State(strains, best, restart), (loss, restart)

    key_first, key_search = jax.random.split(key)
    state = _first_state(representation, problem, length, settings)
    if settings.screen > 1:
        drawn = _start(representation, problem, length, settings, draws=settings.screen, key=key_first)
        loss = losses_of(drawn.plan, drawn.common, drawn.relative, stride=settings.every).loss
        strange = _strange(drawn, problem, settings)
        screened = _least(jnp.where(strange, jnp.inf, loss), drawn, settings.screen)
        state = state._replace(
            strains=_choose(state.restart, screened, state.strains), restart=jnp.zeros_like(state.restart)
        )
    keys = jax.random.split(key_search, settings.iterations(length))
    (_, best, _), (losses, restarts) = jax.lax.scan(iterate, state, keys)
    # The iterations may have used every `every`-th vertex only; the winner is chosen by the loss over all vertices.
    last = losses_of(best.plan, best.common, best.relative)
    winner = jnp.argmin(jnp.where(jnp.isinf(best.loss), jnp.inf, last.loss))
    plan, common, relative = best.plan[winner], best.common[winner], last.relative[winner]
    plan = relabel_manipulation(plan, jnp.asarray(INVERSE)[common])
    terms = {name: values[winner] for name, values in last.terms.items()}
    return Found(plan, last.loss[winner], terms, common, relative, losses, restarts)


def _strange(strains: _Strains, problem: Problem, settings: SearchConfig) -> Bool[Array, " strains"]:
    """Mask of the strains whose first manipulation is unlike those in the training data, `[strains]`.

    In such a manipulation the hands lie on different sides of the line m or, if `fold` is set, q lies off the cloth.
    The nets were not trained on these, so their predictions are not trusted. Null manipulations are never masked.
    """
    first = strains.plan[:, 0]
    strange = ~jnp.asarray(release_points(strains.grasps, first[:, 4:]).same_side) & ~is_null(first)
    if settings.fold:
        assert problem.covered is not None, "a search with `fold` is told what the cloth covers"
        strange |= ~folds(problem.covered, strains.grasps, first)
    return strange


def _start(
    representation: Representation,
    problem: Problem,
    length: int,
    settings: SearchConfig,
    *,
    draws: int = 1,
    key: PRNGKeyArray,
) -> _Strains:
    """New strains with random plans in random common equivalents (design 6.10); `draws` consecutive rows per strain.

    In a later search of a session the common equivalents are assigned in turn instead.
    """
    key_plan, key_common = jax.random.split(key)
    count = settings.strains * draws
    drawn = jax.random.randint(key_common, (count,), 0, representation.labels)
    common = jnp.where(problem.later, jnp.arange(count) // draws % representation.labels, drawn)
    xy = representation.points(problem.state, jnp.asarray(problem.candidates.grasps))
    covered = problem.covered if settings.fold else None
    plans = random_plans(count, length, problem.candidates, xy, covered=covered, key=key_plan)
    return _fresh(representation, plans, common, problem, settings)


def _some_near(
    representation: Representation,
    best: _Best,
    drawn: _Strains,
    problem: Problem,
    settings: SearchConfig,
    *,
    key: PRNGKeyArray,
) -> _Strains:
    """The strains `drawn`, of which a share `settings.near` is replaced by strains near the best plan so far.

    Such a strain has the best plan with noise added to all components but the first grasp points. With a probability
    of one half, its first grasp points are those that were drawn.
    """
    key_share, key_grasps, key_noise = jax.random.split(key, 3)
    count, inverse_of = len(drawn.plan), jnp.asarray(INVERSE)
    winner = jnp.argmin(best.loss)
    plan = relabel_manipulation(best.plan[winner], inverse_of[best.common[winner]])
    noise = NEAR * jax.random.normal(key_noise, drawn.plan.shape)
    both = jnp.where(is_single(plan)[..., None], noise[..., :2], noise[..., 2:4])
    noise = jnp.concatenate([noise[..., :2], both, noise[..., 4:]], axis=-1).at[:, 0, :4].set(0)
    moved = plan + noise
    moved = jnp.concatenate([jnp.clip(moved[..., :4], -1, 1), moved[..., 4:]], axis=-1)
    others = relabel_manipulation_batch(drawn.plan, inverse_of[drawn.common])[:, 0, :4]
    swap = jax.random.bernoulli(key_grasps, 0.5, (count, 1))
    moved = moved.at[:, 0, :4].set(jnp.where(swap, others, moved[:, 0, :4]))
    near = jax.random.bernoulli(key_share, settings.near, (count,)) & jnp.isfinite(best.loss[winner])
    return _choose(near, _fresh(representation, moved, drawn.common, problem, settings), drawn)


def _first_state(representation: Representation, problem: Problem, length: int, settings: SearchConfig) -> _State:
    """The state before the first iteration, in which strains are marked to restart at random plans.

    In a later search of a session, the first strain of each common equivalent is not marked: it starts from the carried
    plan, with the first grasp points replaced by the nearest candidates.
    """
    count = settings.strains
    carried = jnp.asarray(problem.carried)
    wanted = representation.points(problem.state, carried[0, :4].reshape(2, 2))
    xy = representation.points(problem.state, jnp.asarray(problem.candidates.grasps))
    first = snap(carried[0], wanted, problem.candidates, xy)
    plan = jnp.broadcast_to(jnp.concatenate([first[None], carried[1:]]), (count, length, 6))
    strains = _fresh(representation, plan, jnp.arange(count) % representation.labels, problem, settings)
    best = _Best(strains.plan, strains.common, strains.relative, jnp.full(count, jnp.inf))
    return _State(strains, best, restart=~(jnp.asarray(problem.later) & (jnp.arange(count) < representation.labels)))


def _fresh(
    representation: Representation,
    plan: Float[Array, "strains n 6"],
    common: Int[Array, " strains"],
    problem: Problem,
    settings: SearchConfig,
) -> _Strains:
    """Strains in their initial condition, for plans given in the labels of the state."""
    count = len(plan)
    return _Strains(
        plan=relabel_manipulation_batch(plan, common),
        single=is_single(plan),
        grasps=representation.points(problem.state, plan[:, 0, :4].reshape(count, 2, 2)),
        common=common,
        relative=jnp.full(count, problem.relative),
        rate=jnp.full(plan.shape, settings.irprop.initial),
        gradient=jnp.zeros(plan.shape),
        lowest=jnp.full(count, jnp.inf),
        stale=jnp.zeros(count, jnp.int32),
    )


def _move(strains: _Strains, gradient: Float[Array, "strains n 6"], settings: IRpropConfig) -> _Strains:
    """One iRprop- step on the plans.

    The first grasp points do not change, the two equal grasp points of a one-handed manipulation stay equal, and all
    grasp points are clipped to -1..1.
    """
    grasps, displacement = gradient[..., :4], gradient[..., 4:]
    grasps = grasps.at[:, 0].set(0)
    both = grasps[..., :2] + grasps[..., 2:]
    grasps = jnp.where(strains.single[..., None], jnp.concatenate([both, both], axis=-1), grasps)
    gradient = jnp.concatenate([grasps, displacement], axis=-1)
    update, gradient, rate = irprop_minus(gradient, strains.gradient, strains.rate, settings)
    plan = strains.plan + update
    plan = jnp.concatenate([jnp.clip(plan[..., :4], -1, 1), plan[..., 4:]], axis=-1)
    return strains._replace(plan=plan, gradient=gradient, rate=rate)


def _least(loss: Float[Array, " draws"], drawn: _Strains, draws: int) -> _Strains:
    """The strain of lowest loss among each `draws` consecutive rows."""
    best = jnp.argmin(loss.reshape(-1, draws), axis=1)
    chosen = jnp.arange(len(best)) * draws + best
    return jax.tree.map(lambda leaf: leaf[chosen], drawn)


def _choose(condition: Bool[Array, " strains"], yes: Any, no: Any) -> Any:
    """For each strain, the row of `yes` if the condition holds, otherwise the row of `no`."""
    return jax.tree.map(lambda a, b: jnp.where(condition.reshape(-1, *(1,) * (a.ndim - 1)), a, b), yes, no)

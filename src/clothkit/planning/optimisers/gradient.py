"""The paper's search: gradient descent by iRprop- with many strains, which restart when stuck (section 5.1).

Each strain has a plan of its own. A strain that has not improved for some iterations restarts at a random plan; the
best plan of each strain over all of its starts is kept.
"""

from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.vector import is_single
from clothkit.planning.batches import take
from clothkit.planning.irprop import IRpropConfig, irprop_minus
from clothkit.planning.optimisers.space import (
    Best,
    Evaluate,
    Initial,
    Outcome,
    Plans,
    Space,
    begin_with,
    clip_grasps,
    masked,
    select,
)
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]

NEAR = 0.15
"""Standard deviation of the noise added to the best plan when a strain restarts near it [geodesic, or normalised]."""

POLISHING_RATE = 0.01
"""Step size with which the iterations of `GradientConfig.polish` begin [geodesic, or normalised]."""


@config
class GradientConfig:
    """Size and restart rules of a gradient search; the defaults are the paper's."""

    strains: Count = 256
    base_iterations: Annotated[int, Ge(0)] = 25
    iterations_per_step: Annotated[int, Ge(0)] = 25
    screen: Count = 1
    """Random plans drawn for each strain's first start, of which the one of lowest loss is used. Needs no gradients."""
    patience: Count = 5
    """Iterations without improvement after which a strain restarts."""
    near: Annotated[float, Ge(0), Le(1)] = 0.0
    """Share of the restarts that begin near the best plan so far, instead of at a random plan."""
    halvings: Annotated[int, Ge(0)] = 0
    """How often only the better half of the strains is kept: successive halving (Jamieson and Talwalkar, AISTATS 2016).
    Every round evaluates as many plans, so that its iterations double when its strains are halved; the iterations above
    are those of the last round. After each round, the best strains go on in the labels that suit them best."""
    polish: Annotated[int, Ge(0)] = 0
    """Iterations with exact evaluations that end the search, for a few of the best plans, in smaller steps."""
    polished: Count = 4
    """How many plans these are, at most."""
    irprop: IRpropConfig = IRpropConfig()

    def __post_init__(self) -> None:
        parts = 2**self.halvings
        for name in ("strains", "base_iterations", "iterations_per_step"):
            if getattr(self, name) % parts:
                raise ValueError(f"{name} must be a multiple of {parts}, to halve the strains {self.halvings} times")

    @property
    def together(self) -> int:
        """The strains that are left in the last round. As many are moved at a time in all rounds."""
        return self.strains >> self.halvings

    @property
    def finalists(self) -> int:
        """The strains that are left at the end."""
        return min(self.polished, self.together) if self.polish else self.together

    def iterations(self, length: int) -> int:
        """Number of iterations of the last round in a search for plans of this length."""
        return self.base_iterations + self.iterations_per_step * length

    def rounds(self, length: int) -> list[tuple[int, int]]:
        """The number of strains and of iterations in each round of the search, between halvings."""
        last, halvings = self.iterations(length), self.halvings
        return [(self.strains >> number, last >> (halvings - number)) for number in range(halvings + 1)]

    def evaluations(self, length: int) -> int:
        """Number of plans of this length that a search evaluates.

        Those for screening, and those of the best strains in all labels of a square cloth after each round, need no
        gradients.
        """
        screened = self.strains * self.screen if self.screen > 1 else 0
        labelled = (self.halvings + 1) * self.together * SQUARE.count if self.halvings else 0
        moved = sum(strains * iterations for strains, iterations in self.rounds(length))
        return screened + labelled + moved + self.finalists * self.polish

    def shape(self, length: int) -> tuple[int, int]:
        """Iterations of all rounds, each of as many strains as the last round has, and that number."""
        return (self.halvings + 1) * self.iterations(length), self.together


class _Strains(NamedTuple):
    """The state of all strains; every field has a row per strain."""

    plans: Plans
    single: Bool[Array, "strains n"]
    rate: Float[Array, "strains n 6"]
    gradient: Float[Array, "strains n 6"]
    lowest: Float[Array, " strains"]
    stale: Int[Array, " strains"]


class _State(NamedTuple):
    strains: _Strains
    best: Best
    restart: Bool[Array, " strains"]
    """Which strains restart before the next iteration."""


def descend(
    evaluate: Evaluate, space: Space, settings: GradientConfig, *, initial: Initial | None = None, key: PRNGKeyArray
) -> Outcome:
    """Search by gradient descent; the first strains start from the initial plans, the others from random ones.

    A strain whose plan is not valid restarts at once. The rows of the best plans are strains. Groups of strains take
    turns, each as large as the last round's, so that one compiled iteration serves all rounds; the rows of the losses
    are those of a group.
    """
    size, rounds = settings.together, settings.rounds(space.length)

    def iterate(state: _State, turn: tuple[Array, _Draws]) -> tuple[_State, Array]:
        first, draws = turn
        rows = first + jnp.arange(size)
        group = take(state, rows)
        restarted = _started(_some_near(state.best, draws), settings.irprop)
        strains = select(group.restart, restarted, group.strains)
        tried, gradient = _tried(evaluate, space, strains.plans)
        loss = tried.loss
        best = select(loss < group.best.loss, tried, group.best)
        stale = jnp.where(loss < strains.lowest, 0, strains.stale + 1)
        restart = jnp.isinf(loss) | (stale >= settings.patience)
        strains = _moved(strains, gradient, settings.irprop)
        strains = strains._replace(lowest=jnp.minimum(loss, strains.lowest), stale=stale)
        moved = _State(strains, best, restart)
        return jax.tree.map(lambda all, some: all.at[rows].set(some), state, moved), loss

    def pursue(state: _State, turns: tuple[Array, Any]) -> tuple[_State, Array]:
        state, losses = jax.lax.scan(iterate, state, turns)
        return (_sorted(evaluate, space, settings, state) if settings.halvings else state), losses

    key_first, key_search = jax.random.split(key)
    state = _first_state(evaluate, space, settings, initial, key=key_first)
    last = settings.iterations(space.length)
    first = jnp.array([np.arange(last) % (strains // size) * size for strains, _ in rounds])
    # All at once, because a program takes longer to compile if every iteration draws random numbers.
    draws = _draws(space, len(rounds) * last * size, settings.near, key=key_search)
    draws = jax.tree.map(lambda leaf: leaf.reshape(len(rounds), last, size, *leaf.shape[1:]), draws)
    state, losses = jax.lax.scan(pursue, state, (first, draws))
    best = take(state.best, jnp.arange(size))
    return Outcome(_polished(evaluate, space, settings, best) if settings.polish else best, losses.reshape(-1, size))


def _tried(
    evaluate: Evaluate, space: Space, plans: Plans, *, exact: bool = False
) -> tuple[Best, Float[Array, "strains n 6"]]:
    """The plans with their losses, infinite for those that are not valid, and the gradients of the losses."""

    def total(plan: Float[Array, "strains n 6"]) -> tuple[Array, tuple]:
        evaluation = evaluate(Plans(plan, plans.labels), exact=exact)
        return jnp.sum(evaluation.loss), (evaluation.loss, evaluation.labels)

    gradient, (loss, labels) = jax.grad(total, has_aux=True)(plans.plan)
    return Best(plans, labels, masked(loss, space.valid(plans))), gradient


def _polished(evaluate: Evaluate, space: Space, settings: GradientConfig, best: Best) -> Best:
    """The best plans, each after some iterations with exact evaluations in the labels that were found for it."""
    best = take(best, jnp.argsort(best.loss)[: settings.finalists])
    found = jnp.isfinite(best.loss)
    strains = _started(Plans(best.plans.plan, best.labels), settings.irprop)
    strains = strains._replace(rate=jnp.full_like(strains.rate, POLISHING_RATE))

    def iterate(state: tuple[_Strains, Best], _: None) -> tuple[tuple[_Strains, Best], None]:
        strains, best = state
        tried, gradient = _tried(evaluate, space, strains.plans, exact=True)
        best = select(tried.loss < best.loss, tried, best)
        return (_moved(strains, gradient, settings.irprop), best), None

    start = Best(strains.plans, best.labels, jnp.full(len(found), jnp.inf))
    (_, polished), _ = jax.lax.scan(iterate, (strains, start), length=settings.polish)
    return polished._replace(loss=jnp.where(found, polished.loss, jnp.inf))


def _first_state(
    evaluate: Evaluate, space: Space, settings: GradientConfig, initial: Initial | None, *, key: PRNGKeyArray
) -> _State:
    """The state before the first iteration, in which strains without a plan are marked to restart at random ones."""
    count = settings.strains
    drawn = space.sample(count, draws=settings.screen, key=key)
    if settings.screen > 1:
        loss = masked(evaluate(drawn).loss, space.valid(drawn))
        # The plan of lowest loss among each `screen` consecutive ones.
        drawn = take(drawn, jnp.arange(count) * settings.screen + jnp.argmin(loss.reshape(count, -1), axis=1))
    plans, given = begin_with(initial, count, drawn)
    best = Best(plans, plans.labels, jnp.full(count, jnp.inf))
    return _State(_started(plans, settings.irprop), best, restart=~given & (settings.screen == 1))


def _sorted(evaluate: Evaluate, space: Space, settings: GradientConfig, state: _State) -> _State:
    """The strains in order of their best plans.

    As many as there are in the last round are tried in all labels, and go on in those of the lowest loss. A strain
    starts anew from its best plan, unless it found that plan since its last start: then it goes on from where it is.
    """
    strains, best, restart = take(state, jnp.argsort(state.best.loss))
    leading = jnp.arange(settings.together)
    variants = space.variants(take(best.plans, leading))
    found = evaluate(variants)
    loss = masked(found.loss, space.valid(variants)).reshape(len(leading), -1)
    rows = leading * loss.shape[1] + jnp.argmin(loss, axis=1)
    tried = Best(take(variants, rows), take(found.labels, rows), loss.min(axis=1))
    better = select(tried.loss < best.loss[leading], tried, take(best, leading))
    best = jax.tree.map(lambda all, some: all.at[leading].set(some), best, better)
    elsewhere = restart | (best.loss < strains.lowest)
    return _State(select(elsewhere, _started(best.plans, settings.irprop), strains), best, jnp.isinf(best.loss))


class _Draws(NamedTuple):
    """Random numbers for restarts; every field has a row per restart."""

    plans: Plans
    """Random plans."""
    near: Bool[Array, " restarts"]
    """Whether to restart near the best plan so far, instead of at the random plan."""
    noise: Float[Array, "restarts n 6"]
    """What is added to the best plan."""
    swap: Bool[Array, " restarts"]
    """Whether the random plan's first grasp points take the place of the best plan's."""


def _draws(space: Space, count: int, share: float, *, key: PRNGKeyArray) -> _Draws:
    key_plans, key_near, key_noise, key_swap = jax.random.split(key, 4)
    plans = space.sample(count, key=key_plans)
    return _Draws(
        plans,
        jax.random.bernoulli(key_near, share, (count,)),
        NEAR * jax.random.normal(key_noise, plans.plan.shape),
        jax.random.bernoulli(key_swap, 0.5, (count,)),
    )


def _some_near(best: Best, draws: _Draws) -> Plans:
    """The random plans, some of which are replaced by plans near the best one so far.

    Such a plan is the best one with noise added to all components but the first grasp points.
    """
    winner = jnp.argmin(best.loss)
    plan, drawn = best.plans.plan[winner], draws.plans.plan
    both = jnp.where(is_single(plan)[..., None], draws.noise[..., :2], draws.noise[..., 2:4])
    noise = jnp.concatenate([draws.noise[..., :2], both, draws.noise[..., 4:]], axis=-1).at[:, 0, :4].set(0)
    moved = clip_grasps(plan + noise)
    moved = moved.at[:, 0, :4].set(jnp.where(draws.swap[:, None], drawn[:, 0, :4], moved[:, 0, :4]))
    near = draws.near & jnp.isfinite(best.loss[winner])
    return draws.plans._replace(plan=jnp.where(near[:, None, None], moved, drawn))


def _started(plans: Plans, settings: IRpropConfig) -> _Strains:
    """Strains in their initial condition."""
    count = len(plans.plan)
    return _Strains(
        plans=plans,
        single=jnp.asarray(is_single(plans.plan)),
        rate=jnp.full(plans.plan.shape, settings.initial),
        gradient=jnp.zeros(plans.plan.shape),
        lowest=jnp.full(count, jnp.inf),
        stale=jnp.zeros(count, jnp.int32),
    )


def _moved(strains: _Strains, gradient: Float[Array, "strains n 6"], settings: IRpropConfig) -> _Strains:
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
    plan = clip_grasps(strains.plans.plan + update)
    return strains._replace(plans=strains.plans._replace(plan=plan), gradient=gradient, rate=rate)

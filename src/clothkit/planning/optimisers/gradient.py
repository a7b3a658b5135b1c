"""The paper's search: gradient descent by iRprop- with many strains, which restart when stuck (section 5.1).

Each strain has a plan of its own. A strain that has not improved for some iterations restarts at a random plan; the
best plan of each strain over all of its starts is kept.
"""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from clothkit.manipulation.vector import is_single
from clothkit.planning.irprop import IRpropConfig, irprop_minus
from clothkit.planning.optimisers.population import lowest
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
    take,
)
from clothkit.runtime.config import config

Count = Annotated[int, Gt(0)]

NEAR = 0.15
"""Standard deviation of the noise added to the best plan when a strain restarts near it [geodesic, or normalised]."""


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
    """How often only the better half of the strains is kept, at equal intervals of iterations; compare successive
    halving (Jamieson and Talwalkar, AISTATS 2016)."""
    irprop: IRpropConfig = IRpropConfig()

    def __post_init__(self) -> None:
        if self.strains % 2**self.halvings:
            raise ValueError(f"strains must be a multiple of {2**self.halvings}, to be halved {self.halvings} times")

    @property
    def finalists(self) -> int:
        """The strains that are left at the end."""
        return self.strains >> self.halvings

    def iterations(self, length: int) -> int:
        """Number of iterations in a search for plans of this length; each evaluates every strain's loss once."""
        return self.base_iterations + self.iterations_per_step * length

    def rounds(self, length: int) -> list[tuple[int, int]]:
        """The number of strains and of iterations in each round of the search, between halvings."""
        ends = np.linspace(0, self.iterations(length), self.halvings + 2).round().astype(int)
        return [(self.strains >> index, int(count)) for index, count in enumerate(np.diff(ends))]

    def evaluations(self, length: int) -> int:
        """Number of plans of this length that a search evaluates, all but those for screening with gradients."""
        screened = self.strains * self.screen if self.screen > 1 else 0
        return screened + sum(strains * iterations for strains, iterations in self.rounds(length))

    def shape(self, length: int) -> tuple[int, int]:
        """Iterations and strains."""
        return self.iterations(length), self.strains

    def starts(self, length: int) -> int:
        """How often a strain can start: it goes on for at least `patience` iterations."""
        return self.iterations(length) // self.patience + 1


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

    A strain whose plan is not valid restarts at once. The rows of the best plans are strains.
    """

    def iterate(state: _State, key: PRNGKeyArray) -> tuple[_State, tuple[Array, Array]]:
        key_fresh, key_near = jax.random.split(key)
        count = len(state.restart)
        drawn = space.sample(count, key=key_fresh)
        if settings.near:
            drawn = _some_near(state.best, drawn, settings.near, key=key_near)
        strains = select(state.restart, _started(drawn, settings.irprop), state.strains)

        def total(plan: Float[Array, "strains n 6"]) -> tuple[Array, tuple]:
            evaluation = evaluate(Plans(plan, strains.plans.labels))
            return jnp.sum(evaluation.loss), (evaluation.loss, evaluation.labels)

        gradient, (loss, labels) = jax.grad(total, has_aux=True)(strains.plans.plan)
        loss = masked(loss, space.valid(strains.plans))
        best = select(loss < state.best.loss, Best(strains.plans, labels, loss), state.best)
        stale = jnp.where(loss < strains.lowest, 0, strains.stale + 1)
        restart = jnp.isinf(loss) | (stale >= settings.patience)
        strains = _moved(strains, gradient, settings.irprop)
        strains = strains._replace(lowest=jnp.minimum(loss, strains.lowest), stale=stale)
        return _State(strains, best, restart), (loss, restart)

    key_first, key_search = jax.random.split(key)
    state = _first_state(evaluate, space, settings, initial, key=key_first)
    keys = jax.random.split(key_search, settings.iterations(space.length))
    record = []
    for strains, iterations in settings.rounds(space.length):
        if strains < len(state.restart):
            state = take(lowest(state.best.loss, strains), state)
        state, (losses, restarts) = jax.lax.scan(iterate, state, keys[:iterations])
        keys = keys[iterations:]
        missing = ((0, 0), (0, settings.strains - strains))
        record.append((jnp.pad(losses, missing, constant_values=jnp.inf), jnp.pad(restarts, missing)))
    losses, restarts = (jnp.concatenate(parts) for parts in zip(*record, strict=True))
    return Outcome(state.best, losses, restarts)


def _first_state(
    evaluate: Evaluate, space: Space, settings: GradientConfig, initial: Initial | None, *, key: PRNGKeyArray
) -> _State:
    """The state before the first iteration, in which strains without a plan are marked to restart at random ones."""
    count = settings.strains
    drawn = space.sample(count, draws=settings.screen, key=key)
    if settings.screen > 1:
        loss = masked(evaluate(drawn).loss, space.valid(drawn))
        # The plan of lowest loss among each `screen` consecutive ones.
        drawn = take(jnp.arange(count) * settings.screen + jnp.argmin(loss.reshape(count, -1), axis=1), drawn)
    plans, given = begin_with(initial, count, drawn)
    best = Best(plans, plans.labels, jnp.full(count, jnp.inf))
    return _State(_started(plans, settings.irprop), best, restart=~given & (settings.screen == 1))


def _some_near(best: Best, drawn: Plans, share: float, *, key: PRNGKeyArray) -> Plans:
    """The plans `drawn`, of which a share is replaced by plans near the best one so far.

    Such a plan is the best one with noise added to all components but the first grasp points. With a probability of
    one half, its first grasp points are those that were drawn.
    """
    key_share, key_grasps, key_noise = jax.random.split(key, 3)
    count = len(drawn.plan)
    winner = jnp.argmin(best.loss)
    plan = best.plans.plan[winner]
    noise = NEAR * jax.random.normal(key_noise, drawn.plan.shape)
    both = jnp.where(is_single(plan)[..., None], noise[..., :2], noise[..., 2:4])
    noise = jnp.concatenate([noise[..., :2], both, noise[..., 4:]], axis=-1).at[:, 0, :4].set(0)
    moved = clip_grasps(plan + noise)
    swap = jax.random.bernoulli(key_grasps, 0.5, (count, 1))
    moved = moved.at[:, 0, :4].set(jnp.where(swap, drawn.plan[:, 0, :4], moved[:, 0, :4]))
    near = jax.random.bernoulli(key_share, share, (count,)) & jnp.isfinite(best.loss[winner])
    return drawn._replace(plan=jnp.where(near[:, None, None], moved, drawn.plan))


def _started(plans: Plans, settings: IRpropConfig) -> _Strains:
    """Strains in their initial condition."""
    count = len(plans.plan)
    return _Strains(
        plans=plans,
        single=is_single(plans.plan),
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

"""The search for a plan: gradient descent through the forward models, many strains at once (section 5.1).

One program per plan length: `search` is compiled once and serves every batch of tasks of that length. A strain plans in
the labels of its own common equivalent; whatever leaves this module is back in the labels of the state.
"""

from functools import partial
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from annotated_types import Ge, Gt, Le, MultipleOf, Predicate
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, Shaped

from clothkit.cloth.equivalents import COUNT, INVERSE, compose, relabel_manipulation, relabel_manipulation_batch
from clothkit.cloth.grid import SIDE
from clothkit.config import config
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import is_null, is_single
from clothkit.planning.draw import Candidates, folds, random_plans, snap
from clothkit.planning.forward import Forward, unroll
from clothkit.planning.irprop import IRpropConfig, irprop_minus
from clothkit.planning.loss import Range, Spread, Weights, uncertainty

UNKNOWN = -1
"""A relative labelling that is not known yet: each evaluation takes the one that fits best."""

NEAR = 0.15
"""Standard deviation of what moves a plan that begins near another, geodesic or normalised."""

COMPOSED = np.array([[compose(j, k) for k in range(COUNT)] for j in range(COUNT)], np.int32)


@config
class SearchConfig:
    """Size of a search; the defaults are the paper's."""

    strains: Annotated[int, Gt(0), MultipleOf(COUNT)] = 256
    base_iterations: Annotated[int, Ge(0)] = 25
    iterations_per_step: Annotated[int, Ge(0)] = 25
    screen: Annotated[int, Gt(0)] = 1
    """Each strain's first start is the best of so many random plans: their losses cost no gradients."""
    patience: Annotated[int, Gt(0)] = 5
    """A strain that has not improved for so many iterations starts anew."""
    every: Annotated[int, Gt(0), Predicate(lambda every: SIDE % every == 0)] = 1
    """The strains' losses run over one of every `every` vertices along u and v; all count in the last choice."""
    fold: bool = False
    """Whether first manipulations must be of the kind that was recorded: with q on the cloth (section 4.4)."""
    near: Annotated[float, Ge(0), Le(1)] = 0.0
    """Share of the restarts that begin near the best plan so far, in place of at random."""
    irprop: IRpropConfig = IRpropConfig()

    def iterations(self, length: int) -> int:
        """Evaluations of the loss in a search for a plan of this length."""
        return self.base_iterations + self.iterations_per_step * length


class Reference(NamedTuple):
    """What normalises the loss of plans of one length: eq. (14) per net, and eq. (15)."""

    spans: tuple[Range, ...]
    spread: Spread


class Problem(NamedTuple):
    """What one search is asked: all labels are those of `state`, what the current state is taken for."""

    state: Shaped[Array | np.ndarray, "*state"]
    goal: Shaped[Array | np.ndarray, "*state"]
    candidates: Candidates
    traces: tuple[Float[Array | np.ndarray, "labels latent"], ...]
    """For each net, the memory trace of each common equivalent."""
    relative: Int[Array | np.ndarray, ""]
    """The relabelling of the goal that fits the state's labels, or `UNKNOWN`."""
    later: Bool[Array | np.ndarray, ""]
    """Whether `carried` holds what is left of a session's last plan; if so each common equivalent gets an eighth of the
    strains, of which one starts from it."""
    carried: Float[Array | np.ndarray, "n 6"]
    covered: Bool[Array | np.ndarray, "x y"] | None = None
    """What the state covers, for searches with `fold`: pixels of the square that `draw.folds` tells of."""


class Found(NamedTuple):
    """The plan of lowest loss over all strains and iterations, in the labels of the state."""

    plan: Float[Array, "n 6"]
    loss: Float[Array, ""]
    terms: Float[Array, "terms"]
    """The nets' accuracy terms, then u (zero where it was not asked for)."""
    common: Int[Array, ""]
    """The common equivalent in which it was found."""
    relative: Int[Array, ""]
    """The relabelling of the goal towards which it leads."""
    losses: Float[Array, "iterations strains"]
    restarts: Bool[Array, "iterations strains"]
    """Where a strain started anew after that iteration: with `losses`, the best of each restart."""


class _Strains(NamedTuple):
    """A population of plans; every field has a row per strain."""

    plan: Float[Array, "strains n 6"]
    single: Bool[Array, "strains n"]
    grasps: Float[Array, "strains 2 2"]
    """Where the first grasp points lie, xy."""
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
    """Which strains start anew before the next iteration."""


class Fixed(NamedTuple):
    """What does not change during a search: for each net, latents of the equivalents; and the goal's equivalents."""

    latents: tuple[Float[Array, "labels latent"], ...]
    traces: tuple[Float[Array, "labels latent"], ...]
    goals: Float[Array, "labels *state"]


@partial(jax.jit, static_argnames=("forward", "settings", "length", "explicit"))
def search(
    forward: Forward,
    nets: tuple[Any, ...],
    problems: Problem,
    reference: Reference,
    weights: Weights,
    *,
    length: int,
    settings: SearchConfig,
    explicit: bool,
    keys: Shaped[PRNGKeyArray, " tasks"],
) -> Found:
    """The best plans of a batch of problems (every field of `problems` with a leading axis of tasks).

    Two nets plan with eq. (13), one net with the plain NLL. Without `explicit` (alpha is 0) no intermediate state is
    decoded. A task's result depends on its own key, not on its neighbours.
    """
    solve = partial(_search_one, forward, nets, reference, weights, length, settings, explicit)
    return jax.vmap(solve)(problems, keys)


def _search_one(
    forward: Forward,
    nets: tuple[Any, ...],
    reference: Reference,
    weights: Weights,
    length: int,
    settings: SearchConfig,
    explicit: bool,
    problem: Problem,
    key: PRNGKeyArray,
) -> Found:
    fixed = fix(forward, nets, problem)
    losses_of = partial(planning_loss, forward, nets, fixed, reference, weights, explicit=explicit)

    def total(plan: Array, common: Array, relative: Array) -> tuple[Array, tuple[Array, Array]]:
        loss, _, relative = losses_of(plan, common, relative, every=settings.every)
        return jnp.sum(loss), (loss, relative)

    def iterate(state: _State, key: PRNGKeyArray) -> tuple[_State, tuple[Array, Array]]:
        key_fresh, key_near = jax.random.split(key)
        fresh = _start(forward, problem, length, settings, key=key_fresh)
        if settings.near:
            fresh = _some_near(forward, state.best, fresh, problem, settings, key=key_near)
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
    state = _first_state(forward, problem, length, settings)
    if settings.screen > 1:
        drawn = _start(forward, problem, length, settings, draws=settings.screen, key=key_first)
        loss, _, _ = losses_of(drawn.plan, drawn.common, drawn.relative, every=settings.every)
        strange = _strange(drawn, problem, settings)
        screened = _least(jnp.where(strange, jnp.inf, loss), drawn, settings.screen)
        state = state._replace(
            strains=_choose(state.restart, screened, state.strains), restart=jnp.zeros_like(state.restart)
        )
    keys = jax.random.split(key_search, settings.iterations(length))
    (_, best, _), (losses, restarts) = jax.lax.scan(iterate, state, keys)
    # Among the strains' best plans the whole mesh decides.
    loss, terms, relatives = losses_of(best.plan, best.common, best.relative)
    winner = jnp.argmin(jnp.where(jnp.isinf(best.loss), jnp.inf, loss))
    plan, common, relative = best.plan[winner], best.common[winner], relatives[winner]
    plan = relabel_manipulation(plan, jnp.asarray(INVERSE)[common])
    return Found(plan, loss[winner], terms[winner], common, relative, losses, restarts)


def _strange(strains: _Strains, problem: Problem, settings: SearchConfig) -> Bool[Array, " strains"]:
    """Strains whose first manipulation is of a kind that was never recorded: the nets' word on it is worthless, and
    they agree on it. Their hands are on different sides of m, or q is off the cloth. Nulls of all kinds are known."""
    first = strains.plan[:, 0]
    strange = ~jnp.asarray(release_points(strains.grasps, first[:, 4:]).same_side) & ~is_null(first)
    if settings.fold:
        assert problem.covered is not None, "a search with `fold` is told what the cloth covers"
        strange |= ~folds(problem.covered, strains.grasps, first)
    return strange


def fix(forward: Forward, nets: tuple[Any, ...], problem: Problem) -> Fixed:
    """What a search for a problem computes once."""
    states = forward.equivalents(problem.state)
    return Fixed(
        tuple(forward.encode(net, states) for net in nets),
        tuple(jnp.asarray(trace) for trace in problem.traces),
        forward.equivalents(problem.goal),
    )


def planning_loss(
    forward: Forward,
    nets: tuple[Any, ...],
    fixed: Fixed,
    reference: Reference,
    weights: Weights,
    plan: Float[Array, "strains n 6"],
    common: Int[Array, " strains"],
    relative: Int[Array, " strains"],
    *,
    explicit: bool,
    every: int = 1,
) -> tuple[Float[Array, " strains"], Float[Array, "strains terms"], Int[Array, " strains"]]:
    """Eq. (13) of each strain's plan, its terms, and the goal's relative labelling; with one net the plain NLL.

    A relative labelling that is `UNKNOWN` is the one that makes the accuracy terms least, as in eq. (12). Over one of
    every `every` vertices along u and v.
    """
    explicit = explicit and len(nets) > 1
    # Intermediate states are decoded, along with the outcome, only where the loss asks for them.
    decoded = slice(None) if explicit else slice(-1, None)
    states = [
        forward.decode(net, unroll(forward, net, latent[common], trace[common], plan).latents[decoded], every)
        for net, latent, trace in zip(nets, fixed.latents, fixed.traces, strict=True)
    ]
    outcomes = [jax.tree.map(lambda part: part[-1], predicted) for predicted in states]
    spans = reference.spans if len(nets) > 1 else (None,)
    # Whitened as predictions are: by what there is of them.
    goals = forward.target(forward.thinned(fixed.goals, every))
    each = [forward.accuracy_of_each(goals, outcome, span) for outcome, span in zip(outcomes, spans, strict=True)]
    nearest = jnp.argmin(jax.lax.stop_gradient(sum(each)), axis=1)
    found = jnp.asarray(COMPOSED)[nearest, jnp.asarray(INVERSE)[common]]
    relative = jnp.where(relative == UNKNOWN, found, relative)
    goal = goals[jnp.asarray(COMPOSED)[relative, common]]
    accuracies = [forward.accuracy(goal, outcome, span) for outcome, span in zip(outcomes, spans, strict=True)]
    u = jnp.zeros(len(plan))
    if len(nets) == 1:
        return accuracies[0], jnp.stack([accuracies[0], u], axis=-1), relative
    if explicit:
        u = uncertainty(forward.diff(*states), reference.spread, beta=weights.beta, gamma=weights.gamma)
    return sum(accuracies) + weights.alpha * u, jnp.stack([*accuracies, u], axis=-1), relative


def _start(
    forward: Forward, problem: Problem, length: int, settings: SearchConfig, *, draws: int = 1, key: PRNGKeyArray
) -> _Strains:
    """Strains at random plans, in random common equivalents (design 6.10); `draws` in a row for each strain."""
    key_plan, key_common = jax.random.split(key)
    count = settings.strains * draws
    drawn = jax.random.randint(key_common, (count,), 0, forward.labels)
    common = jnp.where(problem.later, jnp.arange(count) // draws % forward.labels, drawn)
    xy = forward.points(problem.state, jnp.asarray(problem.candidates.grasps))
    covered = problem.covered if settings.fold else None
    plans = random_plans(count, length, problem.candidates, xy, covered=covered, key=key_plan)
    return _fresh(forward, plans, common, problem, settings)


def _some_near(
    forward: Forward, best: _Best, drawn: _Strains, problem: Problem, settings: SearchConfig, *, key: PRNGKeyArray
) -> _Strains:
    """Strains of which a share begins near the best plan so far: moved a little, every other one with the first grasp
    points that were drawn for it."""
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
    return _choose(near, _fresh(forward, moved, drawn.common, problem, settings), drawn)


def _first_state(forward: Forward, problem: Problem, length: int, settings: SearchConfig) -> _State:
    """Every strain about to start, but for the first of each common equivalent in a later search: these have the
    carried plan, its first grasp points snapped to candidates."""
    count = settings.strains
    carried = jnp.asarray(problem.carried)
    wanted = forward.points(problem.state, carried[0, :4].reshape(2, 2))
    xy = forward.points(problem.state, jnp.asarray(problem.candidates.grasps))
    first = snap(carried[0], wanted, problem.candidates, xy)
    plan = jnp.broadcast_to(jnp.concatenate([first[None], carried[1:]]), (count, length, 6))
    strains = _fresh(forward, plan, jnp.arange(count) % forward.labels, problem, settings)
    best = _Best(strains.plan, strains.common, strains.relative, jnp.full(count, jnp.inf))
    return _State(strains, best, restart=~(jnp.asarray(problem.later) & (jnp.arange(count) < forward.labels)))


def _fresh(
    forward: Forward,
    plan: Float[Array, "strains n 6"],
    common: Int[Array, " strains"],
    problem: Problem,
    settings: SearchConfig,
) -> _Strains:
    """Strains at the beginning of their search, for plans in the labels of the state."""
    count = len(plan)
    return _Strains(
        plan=relabel_manipulation_batch(plan, common),
        single=is_single(plan),
        grasps=forward.points(problem.state, plan[:, 0, :4].reshape(count, 2, 2)),
        common=common,
        relative=jnp.full(count, problem.relative),
        rate=jnp.full(plan.shape, settings.irprop.initial),
        gradient=jnp.zeros(plan.shape),
        lowest=jnp.full(count, jnp.inf),
        stale=jnp.zeros(count, jnp.int32),
    )


def _move(strains: _Strains, gradient: Float[Array, "strains n 6"], settings: IRpropConfig) -> _Strains:
    """One iRprop- step. First grasp points stay, one hand's two stay together, u and v stay on the cloth."""
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
    """Of each `draws` in a row the one of least loss."""
    best = jnp.argmin(loss.reshape(-1, draws), axis=1)
    chosen = jnp.arange(len(best)) * draws + best
    return jax.tree.map(lambda leaf: leaf[chosen], drawn)


def _choose(condition: Bool[Array, " strains"], yes: Any, no: Any) -> Any:
    """Row by row, the strains of `yes` where the condition holds and of `no` elsewhere."""
    return jax.tree.map(lambda a, b: jnp.where(condition.reshape(-1, *(1,) * (a.ndim - 1)), a, b), yes, no)

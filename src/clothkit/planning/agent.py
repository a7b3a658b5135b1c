"""The agent: observation and memory in, plan and new memory out (section 5.1, design 6.10 and 6.11).

`decide` makes the same decision for episodes, the command line and the viewer. Its parts are public for those that need
one of them: `perceive`, `pose`, `conclude`, `remember`.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Shaped

from clothkit.cloth.topology import PAPERS_CLOTH
from clothkit.dataset.store import STEPS
from clothkit.manipulation.vector import is_null
from clothkit.planning.batches import in_batches, take
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig, chosen_lengths, nearest_labelling
from clothkit.planning.perception import Expected, sigma_of
from clothkit.planning.planner import Planner
from clothkit.planning.predict import Prediction, differences, predict
from clothkit.planning.search import evaluated
from clothkit.planning.trust import ends_worse, signs_of
from clothkit.planning.types import (
    UNKNOWN,
    Candidates,
    Choice,
    Found,
    Memory,
    Observation,
    Plan,
    Problem,
    States,
    Traces,
)
from clothkit.runtime.clock import timed

Keys = Shaped[jax.Array, " task"]


def begin(
    planner: Planner,
    goals: States,
    lengths: Int[np.ndarray, " task"],
    cloth: Float[np.ndarray, "task 3"] | None = None,
) -> Memory:
    """The memory before the first decision: a goal for each task, and the number of manipulations to reach it in.

    `cloth` are the sides and thickness of each cloth; without it, it is the paper's.
    """
    count, candidates = len(goals), planner.grasping.most
    blank = np.zeros((count, *planner.representation.shape), np.float32)
    return Memory(
        goal=goals,
        cloth=np.tile(PAPERS_CLOTH, (count, 1)) if cloth is None else cloth,
        left=np.asarray(lengths, np.int64),
        planned=np.zeros(count, bool),
        still=np.zeros(count, bool),
        state=blank,
        candidates=np.full((count, candidates, 2), np.nan, np.float32),
        relative=np.full(count, 0 if planner.labelled else UNKNOWN, np.int32),
        rest=np.full((count, STEPS, 6), np.nan, np.float32),
        expected=blank,
        unsure=np.full_like(blank, np.inf),
        traces=initial_traces(planner, count),
    )


def initial_traces(planner: Planner, count: int) -> Traces:
    """The initial memory traces t_0 for each net: zeros `[count, labels, latent]`."""
    state = jnp.zeros(planner.representation.shape)
    widths = [jax.eval_shape(planner.model.encode, net, state).shape[-1] for net in planner.nets]
    return tuple(np.zeros((count, planner.representation.labels, width), np.float32) for width in widths)


def decide(
    planner: Planner,
    observation: Observation,
    memory: Memory,
    *,
    key: Keys,
    length: LengthConfig | None = None,
    trust: ErrorMap | None = None,
    sigma: Float[np.ndarray, " task"] | None = None,
) -> tuple[Plan, Memory]:
    """Plan for each task of a batch, and remember what the next decision needs.

    Plans have as many manipulations as are left; with `length`, the agent chooses how many of them are worth it, and
    leaves none if nothing is (section 8). With `trust` (`planning.trust`), it then leaves none, either, where plans
    with such an expectation ended farther from their goals than the cloth lies as it is. `sigma` is how unsure the
    perception is of the states; None: the planner's perception tells.

    `key` has one key per task, so that a task's plan does not depend on the batch. The new memory is that of an agent
    whose plan's first manipulation is executed unless it is null; where that is not so, `remember` gives another one.
    Tasks whose cloth lies as it lay keep their state, whatever is observed. Every task has one to `STEPS`
    manipulations left.
    """
    state, candidates = perceive(planner, observation, memory)
    if length is None:
        plan = _planned(planner, state, candidates, memory, key)
    else:
        if sigma is None and trust is not None:
            sigma = unsure(planner, observation, state, memory)
        plan = _chosen(planner, state, candidates, memory, key, length, trust, sigma)
    return plan, remember(planner, memory, plan, executed=~plan.null)


def _planned(
    planner: Planner,
    state: States,
    candidates: Float[np.ndarray, "task candidate 2"],
    memory: Memory,
    key: Keys,
) -> Plan:
    """For each task, the best plan of as many manipulations as are left."""
    plans, rows_of_plans = [], []
    for length in range(1, STEPS + 1):
        rows = np.flatnonzero(memory.left == length)
        if len(rows):
            problems = pose(planner, state[rows], candidates[rows], take(memory, rows), length)
            found = _searched(planner, problems, key[rows], length)
            plans.append(conclude(planner, problems, found, candidates[rows]))
            rows_of_plans.append(rows)
    return take(_joined(plans), np.argsort(np.concatenate(rows_of_plans), kind="stable"))


def _joined(plans: Sequence[Plan]) -> Plan:
    """The plans of several batches."""
    return jax.tree.map(lambda *parts: np.concatenate(parts), *plans)


def _chosen(
    planner: Planner,
    state: States,
    candidates: Float[np.ndarray, "task candidate 2"],
    memory: Memory,
    key: Keys,
    settings: LengthConfig,
    trust: ErrorMap | None,
    sigma: Float[np.ndarray, " task"] | None,
) -> Plan:
    """For each task, of the best plans of each length that is left, that whose number of manipulations is worth it."""
    count, longest = len(state), planner.normalisation.longest
    found = [
        each
        for length in range(1, longest + 1)
        for each in _without_nulls(planner, state, candidates, memory, key, length)
    ]
    now, relative = nearest_labelling(planner.representation, state, memory)
    expected = np.full((count, longest), np.inf)
    for rows, plans in found:
        # A useless plan is farther from the goal than its start, or no plan at all.
        ends, number = np.where(plans.useless, np.inf, plans.expected), plans.length - 1
        expected[rows, number] = np.minimum(expected[rows, number], ends)
    chosen = chosen_lengths(now, expected, settings)
    parts: list[Plan] = []
    tasks: list[Int[np.ndarray, " rows"]] = []
    for rows, plans in found:
        best = (plans.length == chosen[rows]) & (plans.expected == expected[rows, plans.length - 1])
        best &= ~np.isin(rows, np.concatenate([*tasks, []]))
        if trust is not None and sigma is not None:
            signs = signs_of(plans, sigma[rows], planner.settings.uncertainty.measure)
            worse = best & ends_worse(trust, signs, plans.length, now[rows])
            chosen[rows[worse]] = 0
            best &= ~worse
        parts, tasks = [*parts, take(plans, best)], [*tasks, rows[best]]
    if len(done := np.flatnonzero(chosen == 0)):
        nothing = _nothing(planner, take((state, candidates, memory), done), relative[done], now[done], key[done])
        parts, tasks = [*parts, nothing], [*tasks, done]
    plan = take(_joined(parts), np.argsort(np.concatenate(tasks), kind="stable"))
    return plan._replace(choice=Choice(chosen, np.concatenate([now[:, None], expected], axis=1)))


def _without_nulls(
    planner: Planner,
    state: States,
    candidates: Float[np.ndarray, "task candidate 2"],
    memory: Memory,
    key: Keys,
    length: int,
) -> Iterator[tuple[Int[np.ndarray, " rows"], Plan]]:
    """The best plans of a length, where so many manipulations are left, without the null manipulations among them.

    Yields tasks and their plans, by how many manipulations the plans have; of a plan of null manipulations, nothing.
    """
    rows = np.flatnonzero(memory.left >= length)
    if not len(rows):
        return
    problems = pose(planner, state[rows], candidates[rows], take(memory, rows), length)
    found = _searched(planner, problems, key[rows], length)
    plan, null = np.asarray(found.plan), np.asarray(is_null(np.asarray(found.plan)))
    nulls_last = np.take_along_axis(plan, np.argsort(null, axis=1, kind="stable")[..., None], axis=1)
    for number in range(1, length + 1):
        chosen = np.flatnonzero((~null).sum(1) == number)
        if not len(chosen):
            continue
        tasks = rows[chosen]
        own, of_number = take((problems, found), chosen)
        if number < length:
            own = pose(planner, state[tasks], candidates[tasks], take(memory, tasks), number)
            shorter, relative = nulls_last[chosen, :number], np.asarray(found.relative)[chosen]
            of_number = _evaluated(planner, own, shorter, relative, key[tasks])
        yield tasks, conclude(planner, own, of_number, candidates[tasks])


def _nothing(
    planner: Planner,
    of: tuple[States, Float[np.ndarray, "task candidate 2"], Memory],
    relative: Int[np.ndarray, " task"],
    now: Float[np.ndarray, " task"],
    key: Keys,
) -> Plan:
    """The plans of tasks for which nothing is worth doing: a null manipulation at a candidate, which leaves all as is.

    `now` are the states' distances from the goal in its relabellings `relative`.
    """
    state, candidates, memory = of
    problems = pose(planner, state, candidates, memory, 1)
    null = np.zeros((len(state), 1, 6), np.float32)
    null[:, 0, :4] = np.nan_to_num(np.tile(candidates[:, 0], 2))
    plan = conclude(planner, problems, _evaluated(planner, problems, null, relative, key), candidates)
    return plan._replace(expected=now.astype(plan.expected.dtype), useless=np.ones_like(plan.useless))


def _evaluated(
    planner: Planner,
    problems: Problem,
    plan: Float[np.ndarray, "task n 6"],
    relative: Int[np.ndarray, " task"],
    key: Keys,
) -> Found:
    """Plans that no search found, as if it had."""
    search = partial(evaluated, planner.model, planner.representation, planner.nets)
    objective = planner.objective(plan.shape[1])
    return in_batches(
        lambda problems, plan, relative, key: search(problems, objective, plan, relative, key),
        planner.settings.batch,
        problems,
        plan,
        relative,
        key,
    )


def perceive(
    planner: Planner, observation: Observation, memory: Memory
) -> tuple[States, Float[np.ndarray, "task candidate 2"]]:
    """The states and their candidate grasp points, NaN where there are fewer.

    Cloths that nothing was executed on since the last decision keep their state. Estimates of the others get the labels
    of the expected states, except before the first decision, when nothing is expected.
    """
    state, candidates = memory.state.copy(), memory.candidates.copy()
    first, moved = np.flatnonzero(~memory.planned), np.flatnonzero(memory.planned & ~memory.still)
    for rows, expected in ((first, None), (moved, Expected(memory.expected, memory.unsure))):
        if not len(rows):
            continue
        known = None if expected is None else take(expected, rows)
        state[rows] = planner.perception(take(observation, rows), known, memory.cloth[rows])
        for row in rows:
            points = planner.representation.candidates(state[row], planner.grasping)
            candidates[row] = np.nan
            candidates[row, : len(points)] = points
    return state, candidates


def unsure(planner: Planner, observation: Observation, state: States, memory: Memory) -> Float[np.ndarray, " task"]:
    """How unsure the perception is of the states that `perceive` gave [cloth length]; 0 if it does not tell.

    Where a state was predicted, this is the doubt that is left when the prediction counts, too.
    """
    sigma = np.zeros(len(memory.cloth), np.float32)
    predicted = memory.planned & ~memory.still
    for rows, expected in ((~predicted, None), (predicted, Expected(memory.expected, memory.unsure))):
        rows = np.flatnonzero(rows)
        if len(rows):
            known = None if expected is None else take(expected, rows)
            seen, cloth = take(observation, rows), memory.cloth[rows]
            sigma[rows] = sigma_of(planner.perception, seen, state[rows], known, cloth)
    return sigma


def pose(
    planner: Planner,
    state: States,
    candidates: Float[np.ndarray, "task candidate 2"],
    memory: Memory,
    length: int,
) -> Problem:
    """The problem that a search for plans of one length solves, for each task of a batch."""
    covered = None
    if planner.settings.search.fold or planner.objective(length).draws:
        covered = np.stack([planner.representation.covered(one) for one in state])
    # A plan whose length was chosen anew may be longer than what is left of the one before: null manipulations follow.
    rest = np.where(memory.planned[:, None, None], np.nan_to_num(memory.rest[:, :length]), np.float32(0))
    return Problem(
        state=state,
        goal=memory.goal,
        candidates=Candidates(np.nan_to_num(candidates), np.isfinite(candidates[:, :, 0]).sum(1)),
        traces=memory.traces,
        relative=memory.relative.astype(np.int32),
        later=memory.planned,
        carried=rest,
        cloth=memory.cloth,
        covered=covered,
    )


def _searched(planner: Planner, problems: Problem, keys: Keys, length: int) -> Found:
    """What the search finds for each problem, in batches, with the time of each batch counted under the length."""
    batch = planner.settings.batch

    def timed_search(problems: Problem, keys: jax.Array) -> Found:
        # The last batch is padded with copies. They count, because their searches take as long.
        with timed(str(length), batch):
            return jax.block_until_ready(planner.search(problems, keys, length=length))

    return in_batches(timed_search, batch, problems, keys)


def conclude(
    planner: Planner, problems: Problem, found: Found, candidates: Float[np.ndarray, "task candidate 2"]
) -> Plan:
    """The plans that a search found, with the nets' predictions for them and the null check (section 5.1).

    A plan is useless if the nets, in the mean, expect the state to end farther from the goal than it is, in the
    labelling that the search found, or if the search found no valid plan.
    """
    representation, settings = planner.representation, planner.settings
    state, plan = np.asarray(problems.state), np.asarray(found.plan)
    count, length = plan.shape[:2]
    predictions: tuple[Prediction, ...] = in_batches(
        lambda *batch: predict(planner.model, representation, planner.nets, *batch),
        settings.batch,
        state,
        problems.traces,
        plan,
        found.common,
        problems.cloth,
    )
    means = [representation.mean(prediction.states) for prediction in predictions]
    stds = [std for prediction in predictions if (std := representation.std(prediction.states)) is not None]
    apart = in_batches(partial(differences, representation), settings.batch, predictions)
    goal = representation.relabel(np.asarray(problems.goal), np.asarray(found.relative))
    expected = representation.distance(np.mean([mean[:, -1] for mean in means], axis=0), goal)
    losses = np.asarray(found.losses)
    # Where a search found no valid plan, all of its losses are infinite, and the plan is any.
    without_plan = ~np.isfinite(losses).any(axis=(1, 2))
    useless = (expected > representation.distance(state, goal)) | without_plan
    first_is_null = np.asarray(is_null(plan[:, 0]))
    optimiser = settings.search.optimiser
    return Plan(
        state=state,
        candidates=candidates,
        length=np.full(count, length),
        manipulations=_padded(plan, STEPS),
        loss=np.asarray(found.loss),
        terms=jax.tree.map(np.asarray, found.terms),
        common=np.asarray(found.common),
        relative=np.asarray(found.relative),
        means=_padded(np.stack(means, axis=2), STEPS),
        stds=_padded(np.stack(stds, axis=2), STEPS) if stds else None,
        shifts=_padded(np.stack([np.asarray(prediction.shifts) for prediction in predictions], axis=2), STEPS),
        traces=tuple(np.asarray(prediction.traces) for prediction in predictions),
        differences=None if apart is None else _padded(apart, STEPS),
        expected=expected,
        useless=useless,
        null=useless | first_is_null,
        progress=_padded(np.minimum.accumulate(losses.min(-1), axis=1), optimiser.shape(STEPS)[0]),
        tried=np.full(count, losses.shape[-1]),
    )


def expectation(
    means: Float[np.ndarray, "*batch net x y z"], stds: Float[np.ndarray, "*batch net x y z"] | None
) -> Expected:
    """The mean and the standard deviation of the mixture of the nets' predictions; of voxels, the means' alone."""
    mean = means.mean(-4)
    if stds is None:
        return Expected(mean, np.full_like(mean, np.inf))
    variance = (stds**2 + (means - mean[..., None, :, :, :]) ** 2).mean(-4)
    return Expected(mean, np.sqrt(variance))


def _padded(values: Float[np.ndarray, "task length ..."], length: int) -> np.ndarray:
    """The values with NaN appended along the second axis."""
    missing = length - values.shape[1]
    return np.pad(values, [(0, 0), (0, missing), *[(0, 0)] * (values.ndim - 2)], constant_values=np.nan)


def remember(planner: Planner, memory: Memory, plan: Plan, *, executed: np.ndarray) -> Memory:
    """The memory after a decision: `executed` tells for which tasks the plan's first manipulation is carried out.

    Only there do the expected state and the memory traces move on by one manipulation.
    """

    over = np.zeros_like(executed) if plan.choice is None else plan.choice.length == 0

    def where(new: Any, old: Any) -> np.ndarray:
        return np.where(executed.reshape(-1, *(1,) * (old.ndim - 1)), new, old)

    expected = expectation(plan.means[:, 0], None if plan.stds is None else plan.stds[:, 0])

    return Memory(
        goal=memory.goal,
        cloth=memory.cloth,
        left=np.where(over, 0, memory.left - 1),
        planned=np.ones_like(memory.planned),
        still=~executed,
        state=plan.state,
        candidates=plan.candidates,
        relative=plan.relative.astype(memory.relative.dtype),
        rest=_padded(plan.manipulations[:, 1:], STEPS),
        expected=where(expected.mean, memory.expected),
        unsure=where(expected.std, memory.unsure),
        traces=tuple(where(*pair) for pair in zip(plan.traces, memory.traces, strict=True)),
    )

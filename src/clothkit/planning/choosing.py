"""Plans whose number of manipulations the agent chooses: only as many as are expected to be worth it (section 8)."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int

from clothkit.manipulation.vector import is_null
from clothkit.planning.batches import take
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig, chosen_lengths, nearest_labelling
from clothkit.planning.planner import Planner
from clothkit.planning.plans import Keys, as_found, conclude, joined, pose, searched
from clothkit.planning.trust import ends_worse, signs_of
from clothkit.planning.types import Choice, Memory, Plan, States


def chosen_plans(
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
    plan = take(joined(parts), np.argsort(np.concatenate(tasks), kind="stable"))
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
    found = searched(planner, problems, key[rows], length)
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
            of_number = as_found(planner, own, shorter, relative, key[tasks])
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
    plan = conclude(planner, problems, as_found(planner, problems, null, relative, key), candidates)
    return plan._replace(expected=now.astype(plan.expected.dtype), useless=np.ones_like(plan.useless))

"""The agent: observation and memory in, plan and new memory out (section 5.1, design 6.10 and 6.11).

`decide` makes the same decision for episodes, the command line and the viewer. Its parts are public for those that need
one of them: `perceive`, `doubt` and `remember` here, `pose` and `conclude` in `planning.plans`.
"""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from clothkit.cloth.topology import PAPERS_CLOTH
from clothkit.dataset.store import STEPS
from clothkit.planning.batches import take
from clothkit.planning.choosing import chosen_plans
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig
from clothkit.planning.perception import Expected, sigma_of, stds_of
from clothkit.planning.planner import Planner
from clothkit.planning.plans import Keys, conclude, expectation, joined, padded, pose, searched
from clothkit.planning.types import UNKNOWN, Memory, Meshes, Observation, Plan, States, Traces


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
            sigma = sigma_of(state, doubt(planner, observation, state, memory))
        plan = chosen_plans(planner, state, candidates, memory, key, length, trust, sigma)
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
            found = searched(planner, problems, key[rows], length)
            plans.append(conclude(planner, problems, found, candidates[rows]))
            rows_of_plans.append(rows)
    return take(joined(plans), np.argsort(np.concatenate(rows_of_plans), kind="stable"))


def perceive(
    planner: Planner, observation: Observation, memory: Memory
) -> tuple[States, Float[np.ndarray, "task candidate 2"]]:
    """The states and their candidate grasp points, NaN where there are fewer.

    Cloths that nothing was executed on since the last decision keep their state. Estimates of the others get the labels
    of the expected states, except before the first decision, when nothing is expected.
    """
    state, candidates = memory.state.copy(), memory.candidates.copy()
    for tasks, expected in _expectations(memory):
        moved = ~memory.still[tasks]
        rows = tasks[moved]
        if not len(rows):
            continue
        known = None if expected is None else take(expected, moved)
        state[rows] = planner.perception(take(observation, rows), known, memory.cloth[rows])
        for row in rows:
            points = planner.representation.candidates(state[row], planner.grasping)
            candidates[row] = np.nan
            candidates[row, : len(points)] = points
    return state, candidates


def doubt(planner: Planner, observation: Observation, state: States, memory: Memory) -> Meshes | None:
    """The standard deviations of the states that `perceive` gave [normalised]; None if the perception tells none.

    Where a state was predicted, they are those that are left when the prediction counts, too.
    """
    stds = np.empty_like(state)
    for rows, expected in _expectations(memory):
        seen, cloth = take(observation, rows), memory.cloth[rows]
        own = stds_of(planner.perception, seen, state[rows], expected, cloth)
        if own is None:
            return None
        stds[rows] = own
    return stds


def _expectations(memory: Memory) -> Iterator[tuple[Int[np.ndarray, " rows"], Expected | None]]:
    """Tasks whose states were not predicted, and those whose were, with the predictions.

    A cloth that nothing was executed on lies as it lay, so that nothing is predicted of it.
    """
    predicted = memory.planned & ~memory.still
    for rows, expected in (
        (np.flatnonzero(~predicted), None),
        (np.flatnonzero(predicted), Expected(memory.expected, memory.unsure)),
    ):
        if len(rows):
            yield rows, None if expected is None else take(expected, rows)


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
        rest=padded(plan.manipulations[:, 1:], STEPS),
        expected=where(expected.mean, memory.expected),
        unsure=where(expected.std, memory.unsure),
        traces=tuple(where(*pair) for pair in zip(plan.traces, memory.traces, strict=True)),
    )

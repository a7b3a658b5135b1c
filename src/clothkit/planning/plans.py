"""Plans of a batch of tasks: the problem that a search solves, and what its result is worth to the agent."""

from collections.abc import Sequence
from functools import partial

import jax
import numpy as np
from jaxtyping import Float, Int, Shaped

from clothkit.dataset.store import STEPS
from clothkit.manipulation.vector import is_null
from clothkit.planning.batches import in_batches
from clothkit.planning.perception import Expected
from clothkit.planning.planner import Planner
from clothkit.planning.predict import Prediction, differences, predict
from clothkit.planning.search import evaluated
from clothkit.planning.types import Candidates, Found, Memory, Plan, Problem, States
from clothkit.runtime.clock import timed

Keys = Shaped[jax.Array, " task"]


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


def searched(planner: Planner, problems: Problem, keys: Keys, length: int) -> Found:
    """What the search finds for each problem, in batches, with the time of each batch counted under the length."""
    batch = planner.settings.batch

    def timed_search(problems: Problem, keys: jax.Array) -> Found:
        # The last batch is padded with copies. They count, because their searches take as long.
        with timed(str(length), batch):
            return jax.block_until_ready(planner.search(problems, keys, length=length))

    return in_batches(timed_search, batch, problems, keys)


def as_found(
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
        manipulations=padded(plan, STEPS),
        loss=np.asarray(found.loss),
        terms=jax.tree.map(np.asarray, found.terms),
        common=np.asarray(found.common),
        relative=np.asarray(found.relative),
        means=padded(np.stack(means, axis=2), STEPS),
        stds=padded(np.stack(stds, axis=2), STEPS) if stds else None,
        shifts=padded(np.stack([np.asarray(prediction.shifts) for prediction in predictions], axis=2), STEPS),
        traces=tuple(np.asarray(prediction.traces) for prediction in predictions),
        differences=None if apart is None else padded(apart, STEPS),
        expected=expected,
        useless=useless,
        null=useless | first_is_null,
        progress=padded(np.minimum.accumulate(losses.min(-1), axis=1), optimiser.shape(STEPS)[0]),
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


def joined(plans: Sequence[Plan]) -> Plan:
    """The plans of several batches."""
    return jax.tree.map(lambda *parts: np.concatenate(parts), *plans)


def padded(values: Float[np.ndarray, "task length ..."], length: int) -> np.ndarray:
    """The values with NaN appended along the second axis."""
    missing = length - values.shape[1]
    return np.pad(values, [(0, 0), (0, missing), *[(0, 0)] * (values.ndim - 2)], constant_values=np.nan)

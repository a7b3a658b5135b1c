"""What packing costs: errors of packed nets beside those of the full ones, on the validation split."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from clothkit.dataset.store import STEPS, Dataset
from clothkit.dataset.tasks import tasks_of
from clothkit.episodes.record import Tasks, tasks_of_dataset
from clothkit.episodes.sensors import exact_sensor
from clothkit.episodes.sessions import Execute, run_sessions, search_keys
from clothkit.evaluation.errors import errors
from clothkit.planning import agent
from clothkit.planning.batches import in_batches
from clothkit.planning.perception import KnownMeshes
from clothkit.planning.planner import Planner
from clothkit.planning.predict import predict
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.types import Plan
from clothkit.prebuilt.manifest import Deviation
from clothkit.runtime.errors import InputError

MEASURES = {
    "estimate": "of refined estimates from exact voxels",
    "prediction": "of predictions of recorded manipulations from true meshes, of all nets",
    "plan": "of outcomes that the full nets expect of plans from true meshes",
    "outcome": "of outcomes of sessions of system main, executed in the simulator",
}
"""What each measure is a mean error of."""

HELD = ("estimate", "prediction", "plan")
"""The measures that are held to a limit. Executed outcomes are not: two searches of one net differ by more than it."""

Errors = Float[np.ndarray, " examples"]


def deviation(full: Errors, packed: Errors) -> Deviation:
    """The means of errors of full and packed nets on the same examples."""
    apart, count = packed - full, len(full)
    error = float(apart.std(ddof=1) / np.sqrt(count)) if count > 1 else None
    return Deviation(
        full=round(float(full.mean()), 6),
        packed=round(float(packed.mean()), 6),
        standard_error=None if error is None else round(error, 6),
        count=count,
    )


def deviations(
    full: Planner, packed: Planner, validation: Dataset, *, sequences: int, executed: int, execute: Execute
) -> dict[str, Deviation]:
    """All measures, by name, of two planners of system main, on the first sequences of the validation split.

    Of these, `executed` ones are planned and executed; without any, there is no outcome.
    """
    chosen = list(range(min(sequences, len(validation))))
    tasks = all_tasks(validation, chosen)
    found = {"estimate": [estimate_errors(planner, tasks) for planner in (full, packed)]}
    found["prediction"] = [prediction_errors(planner, tasks) for planner in (full, packed)]
    found["plan"] = [expected_errors(full, tasks, plans) for plans in (first_plans(p, tasks) for p in (full, packed))]
    if executed:
        few = all_tasks(validation, chosen[:executed])
        found["outcome"] = [outcome_errors(planner, few, execute) for planner in (full, packed)]
    return {name: deviation(*pair) for name, pair in found.items()}


def check(found: dict[str, Deviation], *, within: float) -> None:
    """Check that packed nets are hardly worse than full ones, by the measures HELD. Raises InputError.

    What a standard error explains is not held against them: searches through two nets that are nearly equal end in
    different plans, better ones and worse ones.
    """
    for name in HELD:
        worse = found[name].packed / found[name].full - 1
        if worse - (found[name].standard_error or 0) / found[name].full > within:
            raise InputError(
                f"prebuild: mean error {MEASURES[name]} is {found[name].packed:.4f} with packed nets, "
                f"{100 * worse:.1f} % above {found[name].full:.4f}, expected at most {100 * within:g} %; keep more "
                "weights in 16 bits (prebuild.half)"
            )


def all_tasks(dataset: Dataset, sequences: Sequence[int]) -> Tasks:
    """All tasks of some sequences."""
    tasks = [task for sequence in sequences for task in tasks_of(sequence, int(dataset.length[sequence]))]
    return tasks_of_dataset(dataset, tasks, "validation")


def estimate_errors(planner: Planner, tasks: Tasks) -> Errors:
    """Errors of the estimates of all start states, each once."""
    _, each = np.unique([task[:2] for task in tasks.task], axis=0, return_index=True)
    truth, cloth = np.asarray(tasks.start, np.float32)[each], tasks.cloths.cloth[each]
    observation, _ = exact_sensor(planner.perception)(truth, None)
    return np.asarray(errors(planner.perception(observation, None, cloth), truth, cloth=cloth))


def prediction_errors(planner: Planner, tasks: Tasks) -> Errors:
    """Errors of each net's predictions of the goals from the true starts by the recorded manipulations."""
    assert tasks.recorded is not None, "tasks of a dataset"
    found = []
    for length in range(1, STEPS + 1):
        rows = [row for row, task in enumerate(tasks.task) if task.length == length]
        if not rows:
            continue
        plan = np.stack([tasks.recorded[row].manipulations for row in rows]).astype(np.float32)
        means = predicted(planner, np.asarray(tasks.start, np.float32)[rows], plan, tasks.cloths.cloth[rows])
        goal, cloth = np.asarray(tasks.goal, np.float32)[rows], tasks.cloths.cloth[rows]
        found += [np.asarray(errors(mean, goal, cloth=cloth)) for mean in means]
    return np.concatenate(found)


def predicted(
    planner: Planner,
    state: Float[np.ndarray, "task u v 3"],
    plan: Float[np.ndarray, "task n 6"],
    cloth: Float[np.ndarray, "task 3"],
    common: Shaped[np.ndarray, " task"] | None = None,
) -> list[Float[np.ndarray, "task u v 3"]]:
    """Each net's mean prediction of the states after plans, in the labels of the first states."""
    traces = agent.initial_traces(planner, len(state))
    common = np.zeros(len(state), np.int32) if common is None else common

    def outcomes(*batch: Any) -> tuple[np.ndarray, ...]:
        found = predict(planner.model, planner.representation, planner.nets, *batch)
        return tuple(planner.representation.mean(of_net.states)[:, -1] for of_net in found)

    return list(in_batches(outcomes, planner.settings.batch, state, traces, plan, common, cloth))


def first_plans(planner: Planner, tasks: Tasks) -> Plan:
    """The plans of a planner that knows the true start states, but not the labels of the goals."""
    knowing = dataclasses.replace(planner, system=SYSTEMS["b1"], perception=KnownMeshes(labelled=False), labelled=False)
    goals, lengths = np.asarray(tasks.goal, np.float32), np.array([task.length for task in tasks.task])
    memory = agent.begin(knowing, goals, lengths, tasks.cloths.cloth)
    observation, _ = exact_sensor(knowing.perception)(np.asarray(tasks.start, np.float32), None)
    keys = search_keys(tasks, np.arange(len(goals)), 0, planner.settings.seed)
    return agent.decide(knowing, observation, memory, key=keys)[0]


def expected_errors(judge: Planner, tasks: Tasks, plans: Plan) -> Errors:
    """How far from their goals plans are expected to end, by the mean of another planner's nets."""
    found = np.zeros(len(plans.length))
    for length in np.unique(plans.length):
        rows = np.flatnonzero(plans.length == length)
        means = predicted(
            judge, plans.state[rows], plans.manipulations[rows, :length], tasks.cloths.cloth[rows], plans.common[rows]
        )
        goal = np.asarray(tasks.goal, np.float32)[rows]
        found[rows] = errors(np.mean(means, axis=0), goal, aligned=True, cloth=tasks.cloths.cloth[rows])
    return found


def outcome_errors(planner: Planner, tasks: Tasks, execute: Execute) -> Errors:
    """Errors of the outcomes of a planner's sessions."""
    sessions = run_sessions(tasks, planner, execute, refined=False)
    outcome = sessions.state[np.arange(len(sessions)), sessions.length]
    return np.asarray(errors(outcome, sessions.goal, aligned=True, cloth=sessions.cloth))

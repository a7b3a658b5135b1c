"""Validation plans that are executed to their end, and how far their expectation came true."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from tqdm import tqdm

from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.episodes.open_loop import execute_plans, grasp_positions
from clothkit.episodes.record import tasks_of_dataset
from clothkit.episodes.sensors import exact_sensor
from clothkit.episodes.sessions import Execute, search_keys
from clothkit.evaluation.errors import errors
from clothkit.evaluation.settings import CalibrateConfig
from clothkit.planning import trust
from clothkit.planning.agent import begin, decide, doubt
from clothkit.planning.error_map import ErrorMap, fit, fitted_to_others
from clothkit.planning.perception import sigma_of
from clothkit.planning.planner import Planner
from clothkit.runtime.resumable import array_storage, resumable_map


class Planned(NamedTuple):
    """Plans and what came of them, a row per task."""

    sequence: np.ndarray
    start: np.ndarray
    length: np.ndarray
    expected: Float[np.ndarray, " task"]
    """See `trust.Signs`."""
    model_error: Float[np.ndarray, " task"]
    sigma: Float[np.ndarray, " task"]
    error: Float[np.ndarray, " task"]
    """Distance of the real outcome from the goal, aligned [cloth length]."""
    error_no_action: Float[np.ndarray, " task"]


def execute_planned(
    dataset: Dataset, settings: CalibrateConfig, planner: Planner, execute: Execute, *, work: Path
) -> Planned:
    """Plan for all tasks of the last validation sequences, and execute the plans without a look in between.

    The first ones are probed (`probes`), and the map of errors that plans are made with is fitted to that.
    `work` stores finished parts, from which an interrupted run resumes.
    """
    chosen = dataset.indices("validation")[-settings.sequences :].tolist()
    together = planner.settings.together
    parts = [
        [task for sequence in chosen[i : i + together] for task in tasks_of(sequence, int(dataset.length[sequence]))]
        for i in range(0, len(chosen), together)
    ]
    with tqdm(total=sum(map(len, parts)), desc="calibrate", unit="plan") as bar:
        finished = resumable_map(
            lambda part: _planned(dataset, part, planner, execute),
            parts,
            folder=work,
            name="planned",
            storage=array_storage(Planned),
            bar=bar,
            count=lambda piece: len(piece.sequence),
        )
        done = [piece.value for piece in finished]
    return Planned(*(np.concatenate(parts) for parts in zip(*done, strict=True)))


def _planned(dataset: Dataset, chosen: list[Task], planner: Planner, execute: Execute) -> Planned:
    tasks = tasks_of_dataset(dataset, chosen, "validation")
    sequence, start, length = np.array(chosen).T
    observation, _ = exact_sensor(planner.perception)(tasks.start, None)
    goals = planner.representation.of_meshes(tasks.goal)
    memory = begin(planner, goals, length, tasks.cloths.cloth)
    keys = search_keys(tasks, np.arange(len(chosen)), 0, planner.settings.seed)
    plan, _ = decide(planner, observation, memory, key=keys)
    sigma = sigma_of(plan.state, doubt(planner, observation, plan.state, memory))
    signs = trust.signs_of(plan, sigma, planner.settings.uncertainty.measure)
    # A plan of which nothing is expected is not executed.
    manipulations = np.where(plan.useless[:, None, None], np.nan, plan.manipulations)
    position = grasp_positions(planner, plan, tasks.centre)
    outcome = execute_plans(tasks.start, tasks.centre, manipulations, position, execute, tasks.cloths)
    cloth = tasks.cloths.cloth
    nothing = np.asarray(errors(plan.state, tasks.goal, aligned=True, cloth=cloth))
    expected = np.where(plan.useless, nothing, signs.expected)
    return Planned(
        sequence,
        start,
        length,
        *signs._replace(expected=expected),
        np.asarray(errors(outcome, tasks.goal, aligned=True, cloth=cloth)),
        np.asarray(errors(tasks.start, tasks.goal, aligned=True, cloth=cloth)),
    )


def rows(planned: Planned) -> tuple[pd.DataFrame, ErrorMap]:
    """Return a row per plan, and the map that was fitted to all of them.

    The columns are those of `Planned` and, with trusted_, those of `trust.Trusted`: these, intervals and shares too, by
    a map that was fitted to the other sequences' plans, so that they can be held against `error`. NaN where too few
    sequences were planned for.
    """
    names = tuple(name for name in trust.Signs._fields if np.isfinite(getattr(planned, name)).all())
    signs, least = {name: getattr(planned, name) for name in names}, trust.least_of(names)
    step = planned.length - 1
    found = fit(signs, least, step, planned.error)
    columns = {f"trusted_{name}": np.full(len(step), np.nan) for name in trust.Trusted._fields}
    for own, fitted in fitted_to_others(signs, least, step, planned.error, planned.sequence):
        expected = np.asarray(fitted([values[own] for values in signs.values()], step[own]))
        for name, values in trust.of_error(fitted, expected)._asdict().items():
            columns[f"trusted_{name}"][own] = values
    return pd.DataFrame({**planned._asdict(), **columns}), found

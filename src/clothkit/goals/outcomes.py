"""What planners, and the goals' own folds, make of the problems."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int64
from tqdm import tqdm

from clothkit.cloth.silhouette import centred
from clothkit.dataset.store import STEPS
from clothkit.dataset.tasks import Task
from clothkit.episodes.record import Tasks
from clothkit.episodes.sensors import Sensor
from clothkit.episodes.sessions import Execute, run_sessions
from clothkit.goals.problems import Problem, joined
from clothkit.goals.settings import START_NAMES, SourceName
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.named_folds import GOALS
from clothkit.manipulation.turns import planar, turn_manipulation
from clothkit.manipulation.vector import is_single
from clothkit.planning.perception import KnownMeshes
from clothkit.planning.planner import Planner
from clothkit.runtime.resumable import array_storage, resumable_map


class Outcomes(NamedTuple):
    """What a source came to for some problems."""

    mesh: Float[np.ndarray, "problem u v 3"]
    """At its place on the table [normalised]."""
    nulls: Int64[np.ndarray, " problem"]
    """How many manipulations were not executed."""
    expected: Float[np.ndarray, " problem"]
    """The error that the first plan expected of itself [cloth length]; NaN where nothing was planned."""


OUTCOMES = array_storage(Outcomes)

Planners = Mapping[SourceName, tuple[Planner, Sensor | None]]


def outcomes(
    problems: list[Problem], sources: tuple[SourceName, ...], planners: Planners, execute: Execute, *, work: Path
) -> list[tuple[SourceName, list[Problem], Outcomes]]:
    """The outcomes of the problems of each source and repeat; those of `script` begin flat.

    `planners` has a planner, and what it sees with, for each other source. `work` stores what is finished, from which
    an interrupted run resumes.
    """
    groups = [
        (source, [one for one in problems if one.repeat == repeat and (source != "script" or one.start == "flat")])
        for source in sources
        for repeat in sorted({problem.repeat for problem in problems})
    ]
    groups = [(source, some) for source, some in groups if some]

    def run(group: tuple[SourceName, list[Problem]]) -> Outcomes:
        source, some = group
        if source == "script":
            return scripted(some, execute)
        planner, sensor = planners[source]
        return planned(some, for_any_labels(planner), execute, sensor)

    with tqdm(total=sum(len(some) for _, some in groups), desc="plans for goals", unit="problem") as bar:
        finished = resumable_map(
            run, groups, folder=work, name="outcomes", storage=OUTCOMES, bar=bar, count=lambda piece: len(piece.mesh)
        )
        return [(source, some, piece.value) for (source, some), piece in zip(groups, finished, strict=True)]


def for_any_labels(planner: Planner) -> Planner:
    """The planner, for goals that may be reached in any of the cloth's labellings: that of a mesh knows one else."""
    if not isinstance(planner.perception, KnownMeshes):
        return planner
    return dataclasses.replace(planner, perception=KnownMeshes(labelled=False), labelled=False)


def planned(problems: list[Problem], planner: Planner, execute: Execute, sensor: Sensor | None) -> Outcomes:
    """The outcomes of sessions. A problem of more manipulations than a session has gets another one for the rest."""
    lengths = np.array([problem.length for problem in problems])
    meshes = np.stack([problem.mesh for problem in problems])
    nulls, expected = np.zeros(len(problems), np.int64), np.full(len(problems), np.nan, np.float32)
    for first in range(0, int(lengths.max()), STEPS):
        rows = np.flatnonzero(lengths > first)
        tasks = tasks_of_problems([problems[row] for row in rows], meshes[rows], first)
        sessions = run_sessions(tasks, planner, execute, sensor=sensor, refined=False)
        last = (np.arange(len(rows)), sessions.length)
        meshes[rows] = sessions.state[last]
        meshes[rows, ..., :2] += sessions.centre[last][:, None, None]
        nulls[rows] += sessions.null.sum(1)
        if first == 0:
            expected[rows] = sessions.expected[:, 0]
    return Outcomes(meshes, nulls, expected)


def tasks_of_problems(problems: list[Problem], meshes: Float[np.ndarray, "problem u v 3"], first: int) -> Tasks:
    """The tasks of sessions that begin with manipulation `first`, with the cloths as they lie then."""
    states, centres = zip(*(centred(mesh) for mesh in meshes), strict=True)
    names = list(GOALS)
    # A number for each problem, so that its searches draw the same whatever else is evaluated.
    numbers = [
        (problem.repeat * len(names) + names.index(problem.name)) * len(START_NAMES) + START_NAMES.index(problem.start)
        for problem in problems
    ]
    lengths = [min(STEPS, problem.length - first) for problem in problems]
    return Tasks(
        [Task(number, first, length) for number, length in zip(numbers, lengths, strict=True)],
        ["test"] * len(problems),
        np.stack(states),
        np.stack(centres),
        np.stack([problem.goal for problem in problems]),
        joined([problem.cloths for problem in problems]),
    )


def scripted(problems: list[Problem], execute: Execute) -> Outcomes:
    """The outcomes of the goals' own manipulations of the flat cloth, in the world in which plans are executed.

    Its hands are faster than those that made the goal, and may grasp one layer alone.
    """
    meshes = np.stack([problem.flat for problem in problems]).astype(np.float32)
    counts = np.array([len(problem.made.manipulations) for problem in problems])
    for step in range(int(counts.max())):
        rows = np.flatnonzero(counts > step)
        moves = np.stack([problems[row].made.manipulations[step] for row in rows])
        grasps = to_cartesian(np.repeat(meshes[rows][:, None], 2, axis=1), moves[:, :4].reshape(-1, 2, 2))
        angles = jnp.array([problems[row].angle for row in rows])
        turned = turn_manipulation(jnp.asarray(moves), planar(angles, jnp.zeros(len(rows), bool)))
        meshes[rows] = execute(
            meshes[rows],
            np.asarray(grasps)[..., :2],
            np.asarray(turned)[:, 4:],
            np.asarray(is_single(moves)),
            joined([problems[row].cloths for row in rows]),
        )
    return Outcomes(meshes, np.zeros(len(problems), np.int64), np.full(len(problems), np.nan, np.float32))

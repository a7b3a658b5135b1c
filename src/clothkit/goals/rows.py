"""Outcomes of named goals as tidy rows, one per problem and source, and as arrays for pictures."""

from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from clothkit.cloth.silhouette import centred, iou, silhouette
from clothkit.cloth.symmetry import relabel
from clothkit.evaluation.errors import errors, labels_of_truth
from clothkit.goals.measures import softgym
from clothkit.goals.outcomes import Outcomes
from clothkit.goals.problems import Problem
from clothkit.goals.settings import SOURCE_NAMES, START_NAMES, SYSTEM_OF, SourceName
from clothkit.goals.tidy import PICTURED, TABLE
from clothkit.goals.variants import lay
from clothkit.manipulation.named_folds import GOALS

Evaluated = list[tuple[SourceName, list[Problem], Outcomes]]


def rows(evaluated: Evaluated) -> pd.DataFrame:
    """A row per problem and source.

    goal, manipulations (that it needs), start, source, system (that planned; none for a script), repeat; ratio of the
    cloth's sides and its thickness [normalised]; length (manipulations there were); of the outcome, and of doing
    nothing (`_no_action`): error (aligned [cloth length]), softgym (`measures.softgym`, in the labels in which the
    error is smallest [cloth length]; NaN where a goal has no pairs), iou (of the centred silhouettes); nulls; expected.
    """
    found = []
    for source, problems, outcomes in evaluated:
        for number, problem in enumerate(problems):
            along_u, along_v = problem.topology.sides
            flat = problem.flat if source == "script" else problem.flattened
            start = flat if source == "script" else problem.mesh
            columns: dict[str, Any] = {
                "goal": problem.name,
                "manipulations": GOALS[problem.name].manipulations,
                "start": problem.start,
                "source": source,
                "system": SYSTEM_OF.get(source),
                "repeat": problem.repeat,
                "ratio": max(along_u, along_v) / min(along_u, along_v),
                "thickness": float(problem.cloths.cloth[0, 2]),
                "length": len(problem.made.manipulations) if source == "script" else problem.length,
            }
            for name, mesh in (("", outcomes.mesh[number]), ("_no_action", start)):
                columns |= {f"{measure}{name}": value for measure, value in measured(problem, mesh, flat).items()}
            columns["nulls"] = int(outcomes.nulls[number])
            columns["expected"] = float(outcomes.expected[number])
            found.append(columns)
    return pd.DataFrame(found)[list(TABLE.columns)]


def measured(problem: Problem, mesh: Float[np.ndarray, "u v 3"], flat: Float[np.ndarray, "u v 3"]) -> dict[str, float]:
    """error, softgym and iou of a cloth at its place on the table; `flat` is it before any fold, in the same labels."""
    here, goal, topology = centred(mesh)[0], problem.goal, problem.topology
    aligned = here - (here - goal).mean((0, 1))
    label = int(labels_of_truth(aligned[None], goal[None], topology=topology)[0])
    outcome, before = (np.asarray(relabel(each, label, topology)) for each in (mesh, flat))
    return {
        "error": float(errors(here[None], goal[None], aligned=True, topology=topology)[0]),
        "softgym": softgym(outcome, before, topology, GOALS[problem.name].folds(topology)),
        "iou": iou(silhouette(here), silhouette(goal)),
    }


def pictured(evaluated: Evaluated) -> dict[str, np.ndarray]:
    """The arrays of PICTURED; meshes are centred, and turned back by the angles at which the cloths lie."""
    examples = [
        (source, problem, mesh)
        for source, problems, outcomes in evaluated
        for problem, mesh in zip(problems, outcomes.mesh, strict=True)
        if problem.repeat == 0
    ]
    names = list(GOALS)
    values = {
        "goal": np.array([names.index(problem.name) for _, problem, _ in examples]),
        "begins": np.array([START_NAMES.index(problem.start) for _, problem, _ in examples]),
        "source": np.array([SOURCE_NAMES.index(source) for source, _, _ in examples]),
        "target": np.stack([_turned_back(problem.goal, problem) for _, problem, _ in examples]),
        "start": np.stack([_turned_back(problem.mesh, problem) for _, problem, _ in examples]),
        "outcome": np.stack([_turned_back(mesh, problem) for _, problem, mesh in examples]),
    }
    return {name: values[name].astype(declared.dtype) for name, declared in PICTURED.items()}


def _turned_back(mesh: Float[np.ndarray, "u v 3"], problem: Problem) -> Float[np.ndarray, "u v 3"]:
    return centred(lay(mesh, -problem.angle))[0]

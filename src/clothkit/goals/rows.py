"""Outcomes of named goals as tidy rows, one per problem and source, and as arrays for pictures."""

from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from clothkit.cloth.silhouette import centred, iou, silhouette
from clothkit.cloth.symmetry import relabel
from clothkit.dataset.tables import Column, Rule, Table
from clothkit.dataset.zarr_store import Declared
from clothkit.evaluation.arrays import NamedArray
from clothkit.evaluation.errors import errors, labels_of_truth
from clothkit.goals.folds import GOALS
from clothkit.goals.measures import softgym
from clothkit.goals.outcomes import Outcomes
from clothkit.goals.problems import Problem
from clothkit.goals.settings import SOURCE_NAMES, START_NAMES, SYSTEM_OF, SourceName

Evaluated = list[tuple[SourceName, list[Problem], Outcomes]]

_MEASURES = ("error", "softgym", "iou")

_LENGTH = Column("numbers", 0)
_MAYBE = Column("numbers", 0, missing=True)
_SHARE = Column("numbers", 0, 1)

TABLE = Table(
    {
        "goal": Column("text", among=tuple(GOALS)),
        "manipulations": Column("whole numbers", 1),
        "start": Column("text", among=START_NAMES),
        "source": Column("text", among=SOURCE_NAMES),
        "system": Column("text", missing=True),
        "repeat": Column("whole numbers", 0),
        "ratio": Column("numbers", 1),
        "thickness": Column("numbers", 0),
        "length": Column("whole numbers", 1),
        "error": _LENGTH,
        "error_no_action": _LENGTH,
        "softgym": _MAYBE,
        "softgym_no_action": _MAYBE,
        "iou": _SHARE,
        "iou_no_action": _SHARE,
        "nulls": Column("whole numbers", 0),
        "expected": _MAYBE,
    },
    keys=("goal", "start", "source", "repeat"),
    rules=(
        Rule(("length", "nulls"), lambda rows: rows["nulls"] <= rows["length"], "at most as many nulls as its length"),
    ),
)
"""The schema of data/evaluation/goals.parquet."""

PICTURED = {
    "goal": Declared("i8", ("example",)),
    "begins": Declared("i8", ("example",)),
    "source": Declared("i8", ("example",)),
    "target": Declared("f4", ("example", "u", "v", "xyz")),
    "start": Declared("f4", ("example", "u", "v", "xyz")),
    "outcome": Declared("f4", ("example", "u", "v", "xyz")),
}
"""The arrays of data/evaluation/goals.zarr: an example for each goal, start and source of the first repeat.

`goal`, `begins` and `source` are places in GOALS, START_NAMES and SOURCE_NAMES.
"""


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
            start = problem.flat if source == "script" else problem.mesh
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
                columns |= {f"{measure}{name}": value for measure, value in measured(problem, mesh).items()}
            columns["nulls"] = int(outcomes.nulls[number])
            columns["expected"] = float(outcomes.expected[number])
            found.append(columns)
    return pd.DataFrame(found)[list(TABLE.columns)]


def measured(problem: Problem, mesh: Float[np.ndarray, "u v 3"]) -> dict[str, float]:
    """error, softgym and iou of a cloth at its place on the table [normalised]."""
    here, goal, cloth = centred(mesh)[0], problem.goal, problem.cloths.cloth
    aligned = here - (here - goal).mean((0, 1))
    label = int(labels_of_truth(aligned[None], goal[None], cloth=cloth)[0])
    relabelled = [np.asarray(relabel(each, label)) for each in (mesh, problem.flat)]
    return {
        "error": float(errors(here[None], goal[None], aligned=True, cloth=cloth)[0]),
        "softgym": softgym(*relabelled, problem.topology, GOALS[problem.name].folds(problem.topology)),
        "iou": iou(silhouette(here), silhouette(goal)),
    }


def pictured(evaluated: Evaluated) -> dict[str, NamedArray]:
    """The arrays of PICTURED; meshes are centred."""
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
        "target": np.stack([problem.goal for _, problem, _ in examples]),
        "start": np.stack([centred(problem.mesh)[0] for _, problem, _ in examples]),
        "outcome": np.stack([centred(mesh)[0] for _, _, mesh in examples]),
    }
    return {
        name: NamedArray(values[name].astype(declared.dtype), declared.dimensions)
        for name, declared in PICTURED.items()
    }

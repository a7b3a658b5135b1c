"""Plans of n manipulations that are searched for themselves, beside those cut from a plan of three (section 8).

The paper proposes "a planning loss that compares predicted intermediate states against the goal state" for plans of
variable length. Here that is the planner's own objective at the best of a plan's states: the lowest of what it comes
to if the plan ends after one, two or three manipulations. `plan_length.py --intermediate` compares both ways.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from clothkit.dataset.store import STEPS, Dataset
from clothkit.dataset.tasks import tasks_of
from clothkit.episodes.open_loop import execute_plans, grasp_positions
from clothkit.episodes.record import tasks_of_dataset
from clothkit.episodes.sensors import exact_sensor
from clothkit.episodes.sessions import Execute, search_keys
from clothkit.evaluation.comparisons import compare, totals
from clothkit.evaluation.errors import errors
from clothkit.models.forward import ForwardModel
from clothkit.planning import objective as objectives
from clothkit.planning import search
from clothkit.planning.agent import begin, decide, perceive
from clothkit.planning.batches import in_batches
from clothkit.planning.objective import Evaluation, Fixed, Objective
from clothkit.planning.planner import Planner
from clothkit.planning.plans import Keys, conclude, pose
from clothkit.planning.representation import Representation
from clothkit.planning.types import Found, Plan, Problem, States

OWN, CUT = "own", "cut"
TASK = ["split", "system", "sequence", "start", "length"]
KEYS = [*TASK, "way", "n"]


def nearest_step(
    objective: Objective,
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    fixed: Fixed,
    plan: Float[jax.Array, "strains n 6"],
    common: Int[jax.Array, " strains"],
    relative: Int[jax.Array, " strains"],
    *,
    stride: int = 1,
    steps: None = None,
) -> Evaluation:
    """Evaluate plans, as `objective.evaluate` does, as if each ended where its loss is the lowest.

    Without `steps`: optimisers that evaluate plans as if they ended earlier are left out.
    """
    assert steps is None, "an optimiser of whole plans"
    of = (objective, model, representation, nets, fixed, plan, common, relative)
    numbers = range(1, plan.shape[1] + 1)
    found = [objectives.evaluate(*of, stride=stride, steps=jnp.int32(number)) for number in numbers]
    best = jnp.argmin(jnp.stack([each.loss for each in found]), axis=0)

    def chosen(*values: jax.Array) -> jax.Array:
        stacked = jnp.stack(values)
        return jnp.take_along_axis(stacked, best.reshape(1, -1, *(1,) * (stacked.ndim - 2)), axis=0)[0]

    return jax.tree.map(chosen, *found)


def search_for_any(planner: Planner, problems: Problem, keys: Keys) -> Found:
    """Search for plans of which some state, not always the last one, is near the goal."""
    return search.search(
        planner.model,
        planner.representation,
        planner.nets,
        problems,
        planner.objective(STEPS),
        length=STEPS,
        settings=planner.settings.search,
        keys=keys,
        evaluation=nearest_step,
    )


def cut(planner: Planner, plan: Plan, goals: States) -> Plan:
    """Return plans without the manipulations after which the nets, in their mean, expect a greater distance again."""
    goal, means = planner.representation.relabel(goals, plan.relative), plan.means.mean(axis=2)
    distance = np.stack([planner.representation.distance(means[:, step], goal) for step in range(STEPS)], axis=1)
    number = distance.argmin(axis=1) + 1
    kept = (np.arange(STEPS) < number[:, None])[..., None]
    manipulations = np.where(kept, plan.manipulations, np.nan)
    return plan._replace(length=number, manipulations=manipulations, expected=distance.min(axis=1))


def rows_of(planner: Planner, dataset: Dataset, sequences: list[int], split: str, execute: Execute) -> pd.DataFrame:
    """Return rows of all tasks of some sequences: three of way OWN, for n of 1, 2 and 3, and one of way CUT.

    Plans are executed to their end without a look in between.
    """
    recorded = [task for sequence in sequences for task in tasks_of(sequence, int(dataset.length[sequence]))]
    tasks = tasks_of_dataset(dataset, recorded, split)
    goals, cloth, count = planner.representation.of_meshes(tasks.goal), tasks.cloths.cloth, len(recorded)
    observation, _ = exact_sensor(planner.perception)(tasks.start, None)
    keys = search_keys(tasks, np.arange(count), 0, planner.settings.seed)
    plans = []
    for number in range(1, STEPS + 1):
        memory = begin(planner, goals, np.full(count, number), cloth)
        plans.append((OWN, decide(planner, observation, memory, key=keys)[0]))
    state, candidates = perceive(planner, observation, memory)
    problems = pose(planner, state, candidates, memory, STEPS)
    found = in_batches(partial(search_for_any, planner), planner.settings.batch, problems, keys)
    plans.append((CUT, cut(planner, conclude(planner, problems, found, candidates), goals)))
    parts = []
    still = np.asarray(errors(tasks.start, tasks.goal, aligned=True, cloth=cloth))
    for way, plan in plans:
        places = grasp_positions(planner, plan, tasks.centre)
        outcome = execute_plans(tasks.start, tasks.centre, plan.manipulations, places, execute, tasks.cloths)
        part = pd.DataFrame(recorded)[["sequence", "start", "length"]].assign(
            split=split,
            system=planner.system.name,
            way=way,
            n=plan.length,
            expected=plan.expected,
            error=np.asarray(errors(outcome, tasks.goal, aligned=True, cloth=cloth)),
            error_no_action=still,
        )
        parts.append(part)
    return pd.concat(parts, ignore_index=True)[[*KEYS, "expected", "error", "error_no_action"]]


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return mean expected and real errors of plans that are cut, and of those of as many manipulations of their own.

    A row per measure (expected, error) and column (recorded length/start); `difference` is that of CUT to OWN, in
    pairs, with a 95 % bootstrap interval over sequences, and p of a sign-flip test.
    """
    cuts, own = (table[table["way"] == way] for way in (CUT, OWN))
    own = cuts[[*TASK, "n"]].merge(own, on=[*TASK, "n"])
    found = []
    for measure in ("expected", "error"):
        apart = compare(pd.concat([cuts, own]).assign(system=lambda rows: rows["way"]), measure, CUT, OWN)
        for way, rows in ((OWN, own), (CUT, cuts)):
            mean = {(part.split, part.column): part.mean for part in totals(rows, measure)}
            apart[way] = [mean[key] for key in zip(apart["split"], apart["column"], strict=True)]
        found.append(apart)
    shown = ["split", "measure", "column", "sequences", OWN, CUT, "difference", "low", "high", "p"]
    return pd.concat(found, ignore_index=True)[shown]

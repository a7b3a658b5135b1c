"""What share of plans stays where hands can be, and what does that cost?  python studies/reach.py [SEQUENCES] [options]

A plan is made for each task of the first validation sequences (default: 30), by system main as `clothkit plan` makes
it, of a cloth of 0.4 m that first lay flat in the middle of the table. Then both hands are kept in a region:

square              x and y are within -size..size, for sizes of 0.3 to 0.15 m
side                x is at least -size, for sizes of 0.21 to 0 m: what arms at the other side of the table reach

Half of the cloth's side is 0.2 m. Two ways are compared:

turning             the plan as it is, or turned by a symmetry of the cloth; else there is none
terms               as `clothkit plan --reach`: likewise, but else another search has reach as a term of its objective,
                    for the goal as it is or turned

Plans are executed to their end without a look in between, even if nothing is expected to come of them; the error is
that of the outcome against the goal, which is turned with the plan, and that of the cloth as it lies where there is no
plan. A row per region and task goes to reports/<scale>/studies/reach.csv: how its plan came about (found, turned,
searched, none), the errors of its outcome, of the plan without limits and of no action [cloth length], and the error
that the plan expected. Shares of plans that stay inside and mean errors, with 95 % bootstrap intervals over sequences,
go to reach_summary.csv, and a figure to reach.png.

A row that is there is not computed again; those made with other nets or other settings (`fingerprint`) are dropped.
`--draw` summarises and draws the rows that are there. Needs the nets, the normalisation and the dataset
(`dvc repro normalise`).
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from fingerprint import COLUMN, append, fingerprint, read, write
from jaxtyping import Float
from tqdm import tqdm

from clothkit.app import agent_state
from clothkit.app.agent_state import AgentState
from clothkit.app.describe import paths_of
from clothkit.app.inputs import Settings, load_settings
from clothkit.app.observables import input_of
from clothkit.app.options import ObservationOptions, observation_options
from clothkit.app.planner import load_planner
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset import store
from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.episodes.open_loop import execute_plans
from clothkit.episodes.record import Tasks, tasks_of_dataset
from clothkit.episodes.sessions import Execute
from clothkit.evaluation.comparisons import interval
from clothkit.evaluation.errors import errors
from clothkit.observation.states import MeshState
from clothkit.params import load_params
from clothkit.planning.batches import take
from clothkit.planning.planner import Planner, artifacts
from clothkit.planning.reach import MARGIN, WEIGHT, Box, Limits
from clothkit.planning.systems import SYSTEMS
from clothkit.report.figures.studies import reach as draw
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import make_simulator

SIZES = {"square": (0.3, 0.25, 0.21, 0.18, 0.15), "side": (0.21, 0.15, 0.1, 0.05, 0.0)}
"""Of regions [m]."""

FAR = 9.0
"""Where there is no limit [m]."""

SIDE = 0.4
"""Of the cloth [m]."""

SEED = 0
"""Of every search."""

REGION, KEYS = ["region", "size"], ["sequence", "start", "length"]

WAYS = {"turning": ("found", "turned"), "terms": ("found", "turned", "searched")}
"""How the plans came about that each way has."""


def regions() -> dict[tuple[str, float], Limits]:
    """Return the limits of both hands by the region's name and size."""
    found = {}
    for name, sizes in SIZES.items():
        for size in sizes:
            low, high = ((-size, -size), (size, size)) if name == "square" else ((-size, -FAR), (FAR, FAR))
            found[name, size] = Limits((Box((*low, -FAR), (*high, FAR)),))
    return found


class Kept(NamedTuple):
    """A plan within limits."""

    how: str
    """found, turned or searched; none: there is no plan."""
    now: AgentState
    """With that plan and the goal that it leads to; without it, that of the plan without limits."""


def kept_within(limits: Limits, now: AgentState) -> Kept:
    """Return the plan that is made of the one that waits, within limits."""
    try:
        kept = agent_state.kept_within(limits, now, seed=SEED)
    except InputError:
        return Kept("none", now)
    assert kept.planned is not None
    if kept.planned is now.planned:
        return Kept("found", now)
    # The goal of a plan that was searched for may be turned, too.
    return Kept("searched" if np.isfinite(kept.planned.without_limits) else "turned", kept)


def planned_for(planner: Planner, settings: Settings, options: ObservationOptions, tasks: Tasks) -> AgentState:
    """Return what an agent knows when it has planned for the only task, without limits."""
    scale = SIDE / CLOTH_LENGTH
    states = (MeshState(tasks.start[0], tasks.centre[0], scale), MeshState(tasks.goal[0], np.zeros(2), scale))
    start, goal = (
        dataclasses.replace(input_of(state, options, name=name), cloth=tasks.cloths.cloth[0])
        for state, name in zip(states, ("start", "goal"), strict=True)
    )
    now = agent_state.begin(planner, settings, goal, tasks.task[0].length)
    return agent_state.plan(agent_state.observe(now, start), seed=SEED)


def grasps_of(now: AgentState) -> Float[np.ndarray, "n 2 2"]:
    """Return where the hands grasp in each manipulation of the plan, xy on the table [normalised]; NaN if nowhere."""
    assert now.perceived is not None
    assert now.planned is not None
    pose, found = now.perceived.source.pose, []
    for path in paths_of(now.planner, now.planned, pose, now.settings.app.motion):
        points = path.points[:, 0, :2] / pose.scale
        found.append(np.stack([points[0], points[-1]]) if len(points) else np.full((2, 2), np.nan))
    return np.array(found, np.float32)


def outcome_errors(states: list[AgentState], tasks: Tasks, simulator: Execute) -> Float[np.ndarray, " plans"]:
    """Return the errors of the outcomes of several plans for one task [cloth length]."""
    moves = np.stack([now.planned.plan for now in states if now.planned is not None])
    start, centre, cloths = take((tasks.start, tasks.centre, tasks.cloths), np.zeros(len(states), int))
    outcome = execute_plans(start, centre, moves, np.stack([grasps_of(now) for now in states]), simulator, cloths)
    goals = np.stack([now.target for now in states])
    return np.asarray(errors(outcome, goals, aligned=True, cloth=cloths.cloth))


def rows_of(
    planner: Planner,
    settings: Settings,
    options: ObservationOptions,
    tasks: Tasks,
    wanted: dict[tuple[str, float], Limits],
    simulator: Execute,
) -> pd.DataFrame:
    """Return a row per region, for the only task."""
    free = planned_for(planner, settings, options, tasks)
    kept = [kept_within(limits, free) for limits in wanted.values()]
    # Many regions have the same plan, which is executed once.
    distinct = {id(now.planned): now for now in (free, *(one.now for one in kept))}
    error = dict(zip(distinct, outcome_errors(list(distinct.values()), tasks, simulator), strict=True))
    still = float(errors(tasks.start, tasks.goal, aligned=True, cloth=tasks.cloths.cloth)[0])
    rows = []
    for (region, size), one in zip(wanted, kept, strict=True):
        assert one.now.planned is not None
        rows.append(
            {
                "split": tasks.split[0],
                **dict(zip(REGION, (region, size), strict=True)),
                **dict(zip(KEYS, tasks.task[0], strict=True)),
                "how": one.how,
                "error": still if one.how == "none" else error[id(one.now.planned)],
                "error_free": error[id(free.planned)],
                "error_no_action": still,
                "expected": np.nan if one.how == "none" else one.now.planned.expected,
            }
        )
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return shares and mean errors per region, size and way, with 95 % bootstrap intervals over sequences.

    inside: share of tasks with a plan that stays inside; turned, searched: shares of those that came about so; error:
    mean over all tasks, of the cloth as it lies where there is no plan; error_inside: over those with a plan;
    error_free_inside: of the plans without limits for the same tasks; error_free, error_no_action: over all tasks.
    """
    rows = []
    for key, own in table.groupby(REGION, sort=False):
        for way, hows in WAYS.items():
            inside = own["how"].isin(hows)
            error = own["error"].where(inside, own["error_no_action"])
            found: dict[str, Any] = {**dict(zip(REGION, key, strict=True)), "way": way, "tasks": len(own)}
            found |= mean_of(inside.astype(float), own["sequence"], "inside")
            found |= {how: float((inside & (own["how"] == how)).mean()) for how in ("turned", "searched")}
            found |= mean_of(error, own["sequence"], "error")
            found |= {"error_inside": error[inside].mean(), "error_free_inside": own.loc[inside, "error_free"].mean()}
            found |= {name: own[name].mean() for name in ("error_free", "error_no_action")}
            rows.append(found)
    return pd.DataFrame(rows)


def mean_of(values: pd.Series, sequence: pd.Series, name: str) -> dict[str, float]:
    """Return the mean over tasks and its interval."""
    by_sequence = values.groupby(sequence).agg(["sum", "count"])
    low, high = interval(by_sequence["sum"].to_numpy(float), by_sequence["count"].to_numpy(float))
    return {name: float(values.mean()), f"{name}_low": low, f"{name}_high": high}


def missing(table: pd.DataFrame, task: Task) -> dict[tuple[str, float], Limits]:
    """Return the regions for which the table has no row of a task."""
    own = table[(table[KEYS] == list(task)).all(axis=1)]
    known = set(zip(own["region"], own["size"], strict=True))
    return {key: limits for key, limits in regions().items() if key not in known}


def in_force(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows whose regions are among those of the study."""
    known = regions()
    return table[np.array([key in known for key in zip(table["region"], table["size"], strict=True)], bool)]


def conclude(table: pd.DataFrame, folder: Path) -> None:
    """Write and print the summary, and draw it."""
    found = summary(table)
    write(found, folder / "reach_summary.csv")
    draw(found, folder / "reach.png")
    shown = [*REGION, "way", "tasks", "inside", "turned", "searched", "error", "error_inside", "error_free_inside"]
    print(found[shown].round(4).to_string(index=False))


def chosen(dataset: Dataset, count: int) -> list[Task]:
    """Return all tasks of the first validation sequences."""
    sequences = dataset.indices("validation").tolist()[:count]
    return [task for s in sequences for task in tasks_of(s, int(dataset.length[s]))]


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=30)
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--draw", action="store_true", help="only summarise and draw the rows that are there")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    folder = Path("reports") / params.scale / "studies"
    path = folder / "reach.csv"
    if asked.draw:
        conclude(pd.read_csv(path), folder)
        return
    ensure_jax_cache(Path(".work/compiled"))
    folder.mkdir(parents=True, exist_ok=True)
    settings, meshes = load_settings(asked.data), asked.data / "meshes.zarr"
    options = observation_options(settings.app, side=SIDE)
    planner, simulate = load_planner(SYSTEMS["main"], asked.data, settings), params.stages.simulate
    measure = settings.plan.uncertainty.measure
    inputs = [meshes, *artifacts(SYSTEMS["main"], asked.data, settings.members, measure).values()]
    how = (settings.plan, settings.weights, settings.grasping, simulate.simulation, settings.app.motion)
    current = fingerprint(inputs, *how, SEED, WEIGHT, MARGIN)
    dataset, simulator = store.load(meshes), make_simulator(simulate)
    table = in_force(read(path, [*REGION, *KEYS], current))
    for task in tqdm(chosen(dataset, asked.sequences), desc="reach", unit="task"):
        if wanted := missing(table, task):
            tasks = tasks_of_dataset(dataset, [task], "validation")
            found = rows_of(planner, settings, options, tasks, wanted, simulator)
            table = append(table, found.assign(**{COLUMN: current}))
            write(table, path)
    conclude(table, folder)


if __name__ == "__main__":
    main()

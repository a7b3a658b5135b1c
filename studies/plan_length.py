"""What does it bring if the agent chooses how many manipulations?  python studies/plan_length.py [SEQUENCES] [options]

Runs the sessions of all tasks of the first SEQUENCES sequences of a split (default: as many test sequences as the plan
stage has), each with one, two and three manipulations, whatever number its goal was recorded with, and once with as
many as the agent chooses (section 8; `clothkit plan --steps auto`), three at most, by the margin `app.length` of
params.yaml.

A row per way (`steps`: 1, 2, 3, chosen) and task goes to reports/<scale>/studies/plan_length.csv: the number of
manipulations of the first plan and of those that were executed (`planned`, `used`), how far the first plan is expected
to end from the goal (`expected`) and how far the first state seems to be (`expected_no_action`), the outcome's error,
and that of doing nothing. `trusted` is the mean error that plans with such an expectation as the first one's came to
(`planning.trust`; main alone has it): where it is larger than the distance of the state from the goal, the agent that
chooses does nothing. Existing rows are not computed again; those made with other nets or settings (`fingerprint`) are
dropped. Means by task with 95 % bootstrap intervals over sequences, and paired differences of `chosen` to `given`,
the recorded number, go to plan_length_summary.csv, and a figure to plan_length.png.

`--margins` chooses the margin, on the validation split: the sessions with told numbers are run there, and for each
margin the number that it would choose at the first plan is looked up among them. Of the margins whose mean error is
within one standard error of the lowest, the largest is chosen. The table goes to plan_length_margins.csv, and what it
chooses belongs in params.yaml, as app.length.margin, before `chosen` is run.

`--intermediate` compares, on the validation split, plans that are searched for themselves with those that are cut from
a plan of three, by a loss over predicted intermediate states (`intermediate.py`). A row per plan, with its `way` (own,
cut) and its number of manipulations `n`, goes to plan_length_ways.csv; means and paired differences go to
plan_length_ways_summary.csv.

`--system` names another system than main; `--draw` writes the tables and the figure of the rows that are there. Needs
the nets, the normalisation and the dataset; the map of trust is that of the stage calibrate (`dvc repro calibrate`).
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import intermediate
import numpy as np
import pandas as pd
from fingerprint import COLUMN, append, fingerprint, read, write
from jaxtyping import Float
from tqdm import tqdm

from clothkit.dataset import store
from clothkit.dataset.store import STEPS, Dataset
from clothkit.dataset.tasks import tasks_of
from clothkit.episodes.record import Sessions, Tasks, tasks_of_dataset
from clothkit.episodes.sensors import exact_sensor
from clothkit.episodes.sessions import Execute, run_sessions
from clothkit.evaluation.comparisons import compare, interval, totals
from clothkit.evaluation.errors import errors
from clothkit.params import load_params
from clothkit.planning.agent import begin
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.lengths import LengthConfig, chosen_lengths, nearest_labelling
from clothkit.planning.objective import Weights
from clothkit.planning.perception import sigma_of, stds_of
from clothkit.planning.planner import Planner, artifacts, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.trust import PLACE, Signs, load, trusted
from clothkit.report.figures.studies import plan_length as draw
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.simulation.executor import end_workers, make_simulator

TOLD = tuple(str(number) for number in range(1, STEPS + 1))
CHOSEN, GIVEN = "chosen", "given"
KEYS = ["split", "system", "steps", "sequence", "start", "length"]
TOGETHER = 10
"""Sequences whose rows are written at a time: of laptop, sixty tasks, which are three full batches of searches."""

MARGINS = (0.0, 0.0025, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1)


def posed(dataset: Dataset, sequences: list[int], split: str, steps: str) -> Tasks:
    """Return the tasks of sequences, each with another number of manipulations to reach its goal in."""
    number = STEPS if steps == CHOSEN else int(steps)
    recorded = [task for sequence in sequences for task in tasks_of(sequence, int(dataset.length[sequence]))]
    tasks = tasks_of_dataset(dataset, recorded, split)
    return tasks._replace(task=[task._replace(length=number) for task in recorded], recorded=None)


def rows_of(
    planner: Planner, tasks: Tasks, recorded: list[int], sessions: Sessions, steps: str, trust: ErrorMap | None
) -> pd.DataFrame:
    """Return a row per task; `recorded` are the lengths with which the goals were recorded."""
    number, cloth, row = sessions.length.astype(int), sessions.cloth, np.arange(len(sessions))
    within = np.arange(STEPS) < number[:, None]
    planned = np.isfinite(sessions.plan[:, 0, :, 0]).sum(1)
    # A plan of no manipulation is one null manipulation that nobody cancelled.
    none = sessions.null[:, 0] & ~sessions.cancelled[:, 0] & (planned == 1) & (steps == CHOSEN)
    goals = planner.representation.of_meshes(np.asarray(tasks.goal, np.float32))
    now = nearest_labelling(planner.representation, sessions.estimate[:, 0], begin(planner, goals, number, cloth))
    return pd.DataFrame(
        {
            "split": sessions.split.astype(object),
            "system": planner.system.name,
            "steps": steps,
            "sequence": sessions.sequence,
            "start": sessions.start.astype(int),
            "length": recorded,
            "planned": np.where(none, 0, planned),
            "used": (~sessions.null & within).sum(1),
            "expected": sessions.expected[:, 0],
            "expected_no_action": now.distance,
            "trusted": trusted_errors(planner, tasks, sessions, np.maximum(planned, 1), trust),
            "error": np.asarray(errors(sessions.state[row, number], sessions.goal, aligned=True, cloth=cloth)),
            "error_no_action": np.asarray(errors(sessions.state[:, 0], sessions.goal, aligned=True, cloth=cloth)),
        }
    )


def trusted_errors(
    planner: Planner, tasks: Tasks, sessions: Sessions, length: np.ndarray, trust: ErrorMap | None
) -> Float[np.ndarray, " task"]:
    """Return the mean error that plans with such signs as the first plans' came to; NaN where it is not known."""
    unknown = np.full(len(sessions), np.nan)
    if trust is None:
        return unknown
    observation, _ = exact_sensor(planner.perception)(tasks.start, None)
    states = sessions.estimate[:, 0]
    sigma = sigma_of(states, stds_of(planner.perception, observation, states, None, sessions.cloth))
    model_error = sessions.terms[:, 0, -1] if planner.settings.uncertainty.measure == "expected" else unknown
    return trusted(trust, Signs(sessions.expected[:, 0], model_error, sigma), length).error


def run(
    planner: Planner,
    dataset: Dataset,
    sequences: list[int],
    split: str,
    steps: str,
    execute: Execute,
    margin: float,
    trust: ErrorMap | None = None,
) -> pd.DataFrame:
    """Run the sessions of all tasks of some sequences in one way, and return their rows."""
    tasks = posed(dataset, sequences, split, steps)
    recorded = [task.length for sequence in sequences for task in tasks_of(sequence, int(dataset.length[sequence]))]
    choosing = LengthConfig(margin=margin) if steps == CHOSEN else None
    sessions = run_sessions(tasks, planner, execute, length=choosing, trust=trust)
    return rows_of(planner, tasks, recorded, sessions, steps, trust)


def given(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the sessions that had the recorded number of manipulations."""
    return table[table["steps"] == table["length"].astype(str)].assign(steps=GIVEN)


def replayed(table: pd.DataFrame, margin: float) -> pd.DataFrame:
    """Return, per task, the row of the number that a margin would choose at the first plan."""
    keys = [key for key in KEYS if key != "steps"]
    told = table[table["steps"].isin(TOLD)]
    expected = told.pivot_table(index=keys, columns="steps", values="expected").reindex(columns=list(TOLD)).dropna()
    first = told.groupby(keys).first().loc[expected.index]
    settings = LengthConfig(margin=margin)
    now = first["expected_no_action"].to_numpy()
    number = chosen_lengths(now, expected.to_numpy(), settings)
    ends = told.set_index([*keys, "steps"])["trusted"].unstack("steps").reindex(expected.index, columns=list(TOLD))
    ends_of_chosen = ends.to_numpy(float)[np.arange(len(number)), np.maximum(number - 1, 0)]
    number[ends_of_chosen > now] = 0
    picked = first.assign(error=first["error_no_action"], used=0, planned=0)
    for k, steps in enumerate(TOLD, start=1):
        own = told[told["steps"] == steps].set_index(keys).loc[expected.index]
        rows = number == k
        for column in ("error", "used", "planned"):
            picked.loc[rows, column] = own[column][rows]
    return picked.assign(steps=CHOSEN).reset_index()


def margins(table: pd.DataFrame) -> pd.DataFrame:
    """Return mean error and manipulations of each margin, and which is chosen, by the rule in this file's head."""
    found = {margin: replayed(table, margin) for margin in MARGINS}
    mean = {margin: float(rows["error"].mean()) for margin, rows in found.items()}
    best = min(mean, key=mean.__getitem__)
    rows, chosen = [], best
    for margin, own in found.items():
        apart = (own["error"] - found[best]["error"]).groupby(own["sequence"]).mean()
        standard = float(apart.std(ddof=1) / np.sqrt(len(apart))) if len(apart) > 1 else 0.0
        if mean[margin] - mean[best] <= standard:
            chosen = max(chosen, margin)
        difference = mean[margin] - mean[best]
        rows.append((margin, len(own), mean[margin], float(own["used"].mean()), difference, standard))
    table = pd.DataFrame(rows, columns=["margin", "tasks", "error", "used", "difference", "standard_error"])
    return table.assign(chosen=(table["margin"] == chosen).astype(int))


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return means by way and task: of all tasks (`all`), by length/start, and by length over all starts (`1/all`).

    low and high are 95 % bootstrap intervals over sequences; `difference` is that of `chosen` to `given`, in pairs, and
    p is of a sign-flip test. Intervals and p of few sequences are NaN.
    """
    ways = pd.concat([given(table), table])
    found = []
    for (split, system, steps), own in ways.groupby(["split", "system", "steps"], sort=False):
        used = {part.column: part.mean for part in totals(own, "used")}
        nothing = {part.column: part.mean for part in totals(own, "error_no_action")}
        same = {part.column: part.mean for part in totals(own.assign(same=own["used"] == own["length"]), "same")}
        parts = [(part.column, part.total, part.tasks) for part in totals(own, "error")]
        by_sequence = own.groupby("sequence")["error"].agg(["sum", "count"])
        parts.append(("all", by_sequence["sum"].to_numpy(float), by_sequence["count"].to_numpy()))
        used["all"], nothing["all"] = own["used"].mean(), own["error_no_action"].mean()
        same["all"] = (own["used"] == own["length"]).mean()
        for column, total, tasks in parts:
            low, high = interval(total, tasks)
            error = float(total.sum() / tasks.sum())
            row: dict[str, Any] = {"split": split, "system": system, "steps": steps, "column": column}
            row |= {"tasks": int(tasks.sum()), "error": error, "error_low": low, "error_high": high}
            row |= {"used": used[column], "as_recorded": same[column], "error_no_action": nothing[column]}
            found.append(row)
    whole = pd.DataFrame(found)
    pairs = [
        compare(own.assign(system=own["steps"]), "error", CHOSEN, GIVEN).assign(planner=system)
        for system, own in ways[ways["steps"].isin([CHOSEN, GIVEN])].groupby("system")
    ]
    renamed = {"planner": "system", "system": "steps", "low": "difference_low", "high": "difference_high"}
    apart = pd.concat(pairs).rename(columns=renamed)
    columns = ["split", "system", "steps", "column", "difference", "difference_low", "difference_high", "p"]
    return whole.merge(apart[columns], on=columns[:4], how="left")


def main() -> None:
    """Run the study, and write, print and draw its tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", help="[default: plan.test]")
    parser.add_argument("--split", choices=["test", "validation"], default="test")
    parser.add_argument("--system", choices=[name for name, one in SYSTEMS.items() if not one.voxels], default="main")
    parser.add_argument("--margins", action="store_true", help="choose the margin, on the validation split")
    parser.add_argument("--intermediate", action="store_true", help="compare with plans that are cut, likewise")
    parser.add_argument("--draw", action="store_true", help="only write the tables and the figure of existing rows")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    folder = Path("reports") / params.scale / "studies"
    path, ways_path = folder / "plan_length.csv", folder / "plan_length_ways.csv"
    if asked.draw:
        conclude(pd.read_csv(path, dtype={"steps": str, COLUMN: str}), folder, asked.system)
        return
    simulate, plan = params.stages.simulate, params.stages.plan
    weights, margin = Weights(params.alpha, params.beta, params.gamma), params.app.length.margin
    data, meshes, members = Path("data"), Path("data/meshes.zarr"), params.ensemble.members
    ensure_jax_cache(Path(".work/compiled"))
    planner = assemble(SYSTEMS[asked.system], data, weights, plan, simulate.candidates, members)
    split = "validation" if asked.margins or asked.intermediate else asked.split
    dataset = store.load(meshes)
    sequences = dataset.indices(split, evaluated=split == "test").tolist()[: asked.sequences or plan.test]
    folder.mkdir(parents=True, exist_ok=True)
    # Those of main are those of all: rows of several systems have one fingerprint.
    inputs = [meshes, *artifacts(SYSTEMS["main"], data, members, plan.uncertainty.measure).values()]
    settings = (plan, weights, simulate.candidates, simulate.simulation)
    execute = make_simulator(simulate)
    if asked.intermediate:
        mark = fingerprint(inputs, *settings)
        table = read(ways_path, intermediate.KEYS, mark)
        own = table[table["system"] == asked.system]
        for some in parts_of(own, sequences, intermediate.CUT):
            found = intermediate.rows_of(planner, dataset, some, split, execute)
            table = append(table, found.assign(**{COLUMN: mark}))
            write(table, ways_path)
        end_workers()
        compared = intermediate.summary(table[table["system"] == asked.system])
        write(compared, folder / "plan_length_ways_summary.csv")
        print(compared.round(4).to_string(index=False))
        return
    trust = load(data / PLACE) if asked.system == "main" else None
    told = fingerprint([*inputs, data / PLACE], *settings)
    ways = dict.fromkeys(TOLD, told) | ({} if asked.margins else {CHOSEN: fingerprint([], told, margin)})
    table = pd.concat([read(path, KEYS, mark) for mark in (told, fingerprint([], told, margin))])
    table["steps"] = table["steps"].astype(str)
    for steps, mark in ways.items():
        own = table[(table["steps"] == steps) & (table["split"] == split) & (table["system"] == asked.system)]
        for some in parts_of(own, sequences, steps):
            found = run(planner, dataset, some, split, steps, execute, margin, trust)
            table = append(table, found.assign(**{COLUMN: mark}))
            write(table, path)
    end_workers()
    conclude(table, folder, asked.system)


def parts_of(own: pd.DataFrame, sequences: list[int], name: str) -> Iterator[list[int]]:
    """Yield the sequences of which a table has no rows, a few at a time, and show how far they are."""
    missing = [sequence for sequence in sequences if sequence not in set(own["sequence"])]
    with tqdm(total=len(missing), desc=name, unit="sequence") as bar:
        for first in range(0, len(missing), TOGETHER):
            some = missing[first : first + TOGETHER]
            yield some
            bar.update(len(some))


def conclude(table: pd.DataFrame, folder: Path, system: str) -> None:
    """Write and print the tables of what there are rows of, and draw them; margins are those of one system."""
    tried = table[(table["split"] == "validation") & (table["system"] == system) & table["steps"].isin(TOLD)]
    if len(tried):
        chosen = margins(tried)
        write(chosen, folder / "plan_length_margins.csv")
        print(chosen.round(4).to_string(index=False))
    if (table["steps"] == CHOSEN).any():
        found = summary(table)
        write(found, folder / "plan_length_summary.csv")
        shown = ["split", "system", "steps", "column", "tasks", "error", "used", "as_recorded", "difference", "p"]
        print(found[shown].round(4).to_string(index=False))
        draw(found, folder / "plan_length.png")


if __name__ == "__main__":
    main()

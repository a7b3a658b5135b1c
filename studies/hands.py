"""Are plans for two hands better than plans for one or two?  python studies/hands.py [CLOTHS] [options]

System b1 knows true meshes. Its searches draw random plans in which a share of the manipulations is one-handed
(`plan.search.one_handed`): the default, a third, or none (--shares). All else is equal. It plans and executes

goals    named goals (--goals, default half, quarter) of CLOTHS cloths that lie flat (default: 8; those of stage
         evaluate_goals, which takes the first of them, or, with --seed, others)
tasks    all tasks of the first --sequences validation sequences (default: all) in --data/meshes.zarr, if it is there

A row per share and problem goes to reports/<scale>/studies/hands.csv: error of the outcome and of no action [cloth
length], and how many manipulations were executed with one hand. Means with 95 % bootstrap intervals, and paired
differences to the first share with p of a sign-flip test over cloths or sequences, go to hands_summary.csv. With
--seed, both have it in their names. The nets are those in --nets (default: the prebuilt ones).
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from towel import params_of, unpacked_nets

from clothkit.app.prebuilt import PREBUILT
from clothkit.dataset import store
from clothkit.dataset.tasks import tasks_of
from clothkit.episodes.record import Sessions, tasks_of_dataset
from clothkit.episodes.sessions import Execute, run_sessions
from clothkit.evaluation.comparisons import interval, sign_flip
from clothkit.evaluation.errors import errors
from clothkit.goals.outcomes import for_any_labels, tasks_of_problems
from clothkit.goals.problems import problems
from clothkit.goals.store import WORK
from clothkit.manipulation.draws import SINGLE_SHARE
from clothkit.manipulation.vector import is_single
from clothkit.params import Params
from clothkit.planning.objective import Weights
from clothkit.planning.planner import Planner, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import end_workers, make_simulator

GROUP = ["kind", "goal", "length"]


def rows_of(sessions: Sessions, goal: list[str], **named: object) -> pd.DataFrame:
    """Return a row per session."""
    last = np.arange(len(sessions)), sessions.length
    kept = {"cloth": sessions.cloth, "aligned": True}
    single = np.asarray(is_single(sessions.plan[:, :, 0])) & ~sessions.null
    return pd.DataFrame(
        {
            **named,
            "goal": goal,
            "sequence": sessions.sequence,
            "start": sessions.start,
            "length": sessions.length,
            "error": np.asarray(errors(sessions.state[last], sessions.goal, **kept)),
            "error_no_action": np.asarray(errors(sessions.state[:, 0], sessions.goal, **kept)),
            "one_handed": [row[:steps].sum() for row, steps in zip(single, sessions.length, strict=True)],
        }
    )


def planned_goals(planner: Planner, execute: Execute, params: Params, asked: argparse.Namespace) -> pd.DataFrame:
    """Return the rows of named goals, of cloths that lie flat."""
    if (settings := params.stages.evaluate_goals) is None:
        raise InputError(f"params.yaml: scale {params.scale} leaves evaluate_goals out")
    seed = settings.seed if asked.seed is None else asked.seed
    settings = dataclasses.replace(
        settings, goals=tuple(asked.goals), starts=("flat",), repeats=asked.cloths, seed=seed
    )
    with tempfile.TemporaryDirectory() as work:
        found = problems(settings, params.stages.simulate, work=Path(work), goals=WORK)
    tasks = tasks_of_problems(found, np.stack([problem.mesh for problem in found]), 0)
    table = rows_of(run_sessions(tasks, for_any_labels(planner), execute, refined=False), [p.name for p in found])
    return table.assign(kind="goals", sequence=[problem.repeat for problem in found])


def planned_tasks(planner: Planner, execute: Execute, data: Path, sequences: int | None) -> pd.DataFrame:
    """Return the rows of tasks of validation sequences; none without a dataset."""
    if not (data / "meshes.zarr").exists():
        return pd.DataFrame()
    dataset = store.load(data / "meshes.zarr")
    rows = dataset.indices("validation")[:sequences]
    chosen = [task for row in rows for task in tasks_of(int(row), int(dataset.length[row]))]
    sessions = run_sessions(tasks_of_dataset(dataset, chosen, "validation"), planner, execute, refined=False)
    return rows_of(sessions, [""] * len(chosen), kind="tasks")


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return means of each share and group, with paired differences to the first share."""
    found = []
    first = table["share"].iloc[0]
    for (share, *group), own in table.groupby(["share", *GROUP], sort=False):
        pairs = own.merge(table[table["share"] == first], on=[*GROUP, "sequence", "start"], suffixes=("", "_first"))
        pairs["difference"] = pairs["error"] - pairs["error_first"]
        row = dict(zip(["share", *GROUP], [share, *group], strict=True)) | {
            "plans": len(own),
            "one_handed": own["one_handed"].sum() / own["length"].sum(),
            "error_no_action": own["error_no_action"].mean(),
        }
        for measure in ("error", "difference"):
            sums = pairs.groupby("sequence")[measure].agg(["sum", "count"]).to_numpy(float).T
            low, high = interval(*sums)
            row |= {measure: pairs[measure].mean(), f"{measure}_low": low, f"{measure}_high": high}
        row["p"] = sign_flip(sums[0])
        found.append(row)
    return pd.DataFrame(found)


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloths", type=int, nargs="?", default=8)
    parser.add_argument("--goals", nargs="+", default=["half", "quarter"])
    parser.add_argument("--seed", type=int, help="of the cloths (default: evaluate_goals.seed)")
    parser.add_argument("--sequences", type=int)
    parser.add_argument("--shares", type=float, nargs="+", default=[SINGLE_SHARE, 0.0])
    parser.add_argument("--nets", type=Path, default=PREBUILT / "household", help="a folder of nets")
    parser.add_argument("--data", type=Path, default=Path("data"), help="where meshes.zarr is")
    asked = parser.parse_args()
    folder = unpacked_nets(asked.nets)
    params = params_of(folder)
    stages = params.stages
    simulator = make_simulator(stages.simulate)
    tables = []
    for share in asked.shares:
        plan = dataclasses.replace(stages.plan, search=dataclasses.replace(stages.plan.search, one_handed=share))
        weights = Weights(params.alpha, params.beta, params.gamma)
        planner = assemble(SYSTEMS["b1"], folder, weights, plan, stages.simulate.candidates, params.ensemble.members)
        for table in (
            planned_goals(planner, simulator, params, asked),
            planned_tasks(planner, simulator, asked.data, asked.sequences),
        ):
            tables.append(table.assign(share=share))
    end_workers()
    table = pd.concat(tables, ignore_index=True)
    table = table[["share", "kind", *(name for name in table if name not in ("share", "kind"))]]
    out = Path("reports") / params.scale / "studies"
    out.mkdir(parents=True, exist_ok=True)
    of = "" if asked.seed is None else f"_seed_{asked.seed}"
    for name, content in (("hands", table), ("hands_summary", summary(table))):
        content.to_csv(out / f"{name}{of}.csv", index=False, float_format="%.5g", lineterminator="\n")
    print(summary(table).round(4).to_string(index=False))


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"hands: {error}") from error

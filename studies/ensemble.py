"""How many forward models should an ensemble have?  python studies/ensemble.py [SEQUENCES] [options]

Plans and executes all tasks of the first validation sequences (default: 30) with system main and ensembles of 1, 2, 3
and 5 nets, and predicts the results of the recorded manipulations with each ensemble. The first nets are the ensemble
of params.yaml in data/nets/pemd; the others are trained by the same recipe from their own keys and kept in
data/studies/ensemble/pemd, and trained again only if the recipe or the data change. An interrupted training resumes.
The single net is that of system b2: the one of the ensemble of params.yaml with the best validation score. Each
ensemble has its own reference values (eqs. 14 and 15), computed as in the normalise stage with the same draws.

All ensembles search with the settings of params.yaml, so with equally many evaluations of the planning loss; one
evaluation of K nets costs K times that of one net, therefore the seconds are given, too. Losses of a single net and of
several nets are not comparable: the former is the net's NLL.

A row per number of nets and task goes to reports/<scale>/studies/ensemble.csv: the results of the session, the seconds
per plan of that length, and two errors of predictions that start from refined estimates, as in table 3:
`prediction_error` is that of the mean of the nets' predictions, which is what the planner expects, and
`prediction_error_single` the mean of the errors of the single nets. Existing rows are not computed again; rows made
with other nets or other settings (`fingerprint`) are dropped. Seconds exclude the first call of each length, which
compiles; lengths with a single call have NaN.

ensemble_summary.csv has the mean of each measure by number of nets and column of the tables (length/start) with its
95 % bootstrap interval over sequences, and the paired difference to two nets with its interval and p. `failure` is the
share of search failures (the recorded plan has the lower loss), `uncertainty` is u of eq. (15) for the first plan,
`training_minutes` is CPU time and `training_wall_minutes` elapsed time of all nets. A net counts as the mean of the
others if its training was not measured in one go, here or by the train_pemd stage (reports/<scale>/timings.csv). The
figure ensemble.png shows the summary. Needs the nets, the normalisation and the dataset (`dvc repro normalise`).

Options: `--counts N ..` (1 2 3 5) are the numbers of nets. `--train-only` trains the nets that are missing and ends.
`--draw` only draws the existing summary.
"""

import argparse
import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import count, islice, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import trained
from fingerprint import COLUMN, append, fingerprint, read, write
from search import seconds_per_plan
from trained import cost_beside, is_trained

from clothkit.dataset import store
from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.episodes.evaluate import try_out
from clothkit.evaluation import comparisons, estimation, prediction
from clothkit.evaluation.comparisons import compare, interval, totals
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.errors import errors
from clothkit.evaluation.prediction import Starts
from clothkit.evaluation.session_rows import rows
from clothkit.models import ensemble
from clothkit.models import store as net_store
from clothkit.models.ensemble import Ensemble, best_member
from clothkit.models.net import Net
from clothkit.params import Params, load_params
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import normalise
from clothkit.planning.objective import Weights
from clothkit.planning.planner import Planner, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.uncertainty_terms import UncertaintyConfig
from clothkit.report.figures.studies import ensemble as draw
from clothkit.runtime.json_file import read_json
from clothkit.simulation.executor import make_simulator

DATA = Path("data")
MESHES, AUGMENTED, OWN = DATA / "meshes.zarr", DATA / "augmented.zarr", DATA / "studies/ensemble"
PAPER = 2
"""The number of nets that the others are compared with."""
TOGETHER = 10
"""Number of sequences after which rows are written."""
MEASURES = ("error", "prediction_error", "prediction_error_single", "failure", "uncertainty")
COSTS = {"training_minutes": "cpu_seconds", "training_wall_minutes": "seconds"}
KEYS = ["nets", *comparisons.KEYS]


def places(number: int, members: Sequence[int]) -> dict[int, Path]:
    """Return the folder of each net of an ensemble of that size, by member.

    The nets of `members`, the ensemble of params.yaml, come first; the single net is the best of these.
    """
    found = ensemble.folders(DATA / "nets", "pemd", members)
    if number == 1:
        best = best_member(found)
        return {best: found[best]}
    more = islice((member for member in count() if member not in found), max(number - len(found), 0))
    return {**dict(islice(found.items(), number)), **ensemble.folders(OWN, "pemd", list(more))}


def of_training(params: Params, member: int) -> str:
    """Return the fingerprint of the data and the settings that a net of the study is trained with."""
    return fingerprint([MESHES, AUGMENTED], params.stages.train_pemd, member)


def train(member: int, params: Params, validation: Dataset) -> None:
    """Train a net of the study, unless it is there."""
    trained.train(OWN, member, params, lambda: store.load(AUGMENTED), validation, of_training(params, member))


def loaded(found: Mapping[int, Path]) -> Ensemble:
    """Return the ensemble of the nets in these folders."""
    nets = tuple(net_store.load(folder, "pemd") for folder in found.values())
    return Ensemble(tuple(found), nets, tuple(found).index(best_member(found)))


def starts(dataset: Dataset, sequences: Sequence[int], params: Params) -> Starts:
    """Return the states from which predictions start: the refined estimates of all states of these sequences."""
    chosen = dataclasses.replace(dataset, evaluated=np.isin(np.arange(len(dataset)), sequences))
    vtm = net_store.load(DATA / "nets/vtm", "vtm")
    found = estimation.estimates(chosen, vtm, params.stages.evaluate_estimation, params.stages.plan.refine)
    return prediction.starts(chosen, found._asdict())


def predicted(dataset: Dataset, initial: Starts, nets: Sequence[Net], batch: int) -> pd.DataFrame:
    """Return a row per task with the prediction errors of an ensemble and of its single nets [cloth length]."""
    found = []
    for start, length in TASKS:
        long = dataset.length[initial.sequence] >= start + length
        sequence, meshes = initial.sequence[long], initial.meshes["main"][long, start]
        if not len(sequence):
            continue
        manipulations, cloth = dataset.manipulation[sequence, start : start + length], dataset.cloth[sequence]
        truth = dataset.vertices[sequence, start + length]
        means = [prediction.predict(net, meshes, manipulations, batch, cloth)[0].mean[-1] for net in nets]
        single = np.mean([errors(mean, truth, cloth=cloth) for mean in means], axis=0)
        of_all = np.asarray(errors(np.mean(means, axis=0), truth, cloth=cloth))
        of_task = {"prediction_error": of_all, "prediction_error_single": single}
        found.append(pd.DataFrame({"sequence": sequence, "start": start, "length": length, **of_task}))
    return pd.concat(found, ignore_index=True)


def planned(dataset: Dataset, sequences: list[int], planner: Planner, params: Params) -> pd.DataFrame:
    """Return a row per task of these sequences with the results of its session."""
    simulator = make_simulator(params.stages.simulate)
    annotate = partial(diagnosed, planner=planner)
    sessions, times = try_out(dataset, sequences, "validation", planner, simulator, annotate=annotate)
    found = rows(sessions, planner.system.name)
    return found.assign(seconds=found["length"].map(seconds_per_plan(times)))


def summary(table: pd.DataFrame, training: Mapping[str, Mapping[int, float]]) -> pd.DataFrame:
    """Return a row per number of nets, measure and column of the tables; `training`: minutes by measure and number."""
    table = table.assign(
        system=table["nets"].astype(str),
        failure=(table["loss_recorded"] < table["loss"]).astype(float),
        uncertainty=table["uncertainty"].where(table["nets"] > 1),
    )
    found: list[dict[Any, Any]] = []
    for number, measure in product(sorted(table["nets"].unique()), MEASURES):
        own = table[(table["nets"] == number) & table[measure].notna()]
        against = table[table["nets"].isin([PAPER, number])]
        paired = compare(against, measure, str(number), str(PAPER)).set_index("column") if number != PAPER else None
        for part in totals(own, measure):
            low, high = interval(part.total, part.tasks)
            row: dict[Any, Any] = {
                "nets": number,
                "measure": measure,
                "column": part.column,
                "sequences": len(part.total),
            }
            row |= {"mean": part.mean, "low": low, "high": high}
            if paired is not None and part.column in paired.index:
                pair = paired.loc[part.column]
                row |= {"difference": pair["difference"], "p": pair["p"]}
                row |= {"difference_low": pair["low"], "difference_high": pair["high"]}
            found.append(row)
    for row in table.groupby(["nets", "length"])["seconds"].mean().reset_index().to_dict("records"):
        column = f"{row['length']}/all"
        found.append({"nets": row["nets"], "measure": "seconds", "column": column, "mean": row["seconds"]})
    for measure, minutes in training.items():
        found += [{"nets": n, "measure": measure, "column": "all", "mean": value} for n, value in minutes.items()]
    columns = ["nets", "measure", "column", "sequences", "mean", "low", "high"]
    columns += ["difference", "difference_low", "difference_high", "p"]
    return pd.DataFrame(found, columns=columns).astype({"sequences": "Int64"})


def training_minutes(numbers: Iterable[int], params: Params, folder: Path) -> dict[str, dict[int, float]]:
    """Return the minutes of training by measure and number of nets; `folder` is that of the report.

    A net whose training was not measured counts as the mean of those that were; NaN if there are none.
    """
    path = folder / "timings.csv"
    noted = pd.read_csv(path).set_index("stage") if path.exists() else pd.DataFrame()
    found: dict[str, dict[int, float]] = {}
    ensembles = {number: places(number, params.ensemble.members) for number in numbers}
    for measure, column in COSTS.items():
        seconds: dict[int, Any] = {}
        for member, net in {member: net for nets in ensembles.values() for member, net in nets.items()}.items():
            cost, stage = cost_beside(net), f"train_pemd@{member}"
            if cost.exists():
                seconds[member] = read_json(cost, expected="the seconds of a training")[column]
            elif stage in noted.index:
                seconds[member] = noted.loc[stage, column]
        known = {member: float(value) for member, value in seconds.items() if value is not None}
        mean = float(np.mean(list(known.values()))) if known else float("nan")
        found[measure] = {
            number: sum(known.get(member, mean) for member in nets) / 60 for number, nets in ensembles.items()
        }
    return found


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=30)
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 2, 3, 5], choices=range(1, 21), metavar="N")
    parser.add_argument("--train-only", action="store_true", help="train the nets that are missing, and end")
    parser.add_argument("--draw", action="store_true", help="only draw the summary that is there; needs no nets")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    folder = Path("reports") / params.scale / "studies"
    path, of_all = folder / "ensemble.csv", folder / "ensemble_summary.csv"
    if asked.draw:
        draw(pd.read_csv(of_all), folder / "ensemble.png")
        return
    stages, members = params.stages, params.ensemble.members
    dataset = store.load(MESHES)
    validation = dataset.of_split("validation")
    for member in places(max(asked.counts), members):
        if member not in members:
            train(member, params, validation)
    if asked.train_only:
        return
    folder.mkdir(parents=True, exist_ok=True)
    # Other measures need a support model and a map of errors of the very ensemble: see doubt_amount.py.
    uncertainty = UncertaintyConfig(u_weight=stages.plan.uncertainty.u_weight)
    weights = Weights(params.alpha, params.beta, params.gamma)
    # Eq. (15) does not tell first displacements that the data do not have; the rule does.
    search = dataclasses.replace(stages.plan.search, fold=True)
    plan = dataclasses.replace(stages.plan, search=search, uncertainty=uncertainty)
    settings = [
        plan.search,
        plan.uncertainty,
        plan.refine,
        plan.batch,
        plan.seed,
        weights,
        stages.normalise,
        stages.evaluate_estimation,
    ]
    settings += [stages.simulate.candidates, stages.simulate.simulation]
    stored = pd.read_csv(path)["nets"].tolist() if path.exists() else []
    current = {}
    for number in sorted({*asked.counts, *stored}):
        folders = places(number, members)
        if all(member in members or is_trained(net, of_training(params, member)) for member, net in folders.items()):
            current[number] = fingerprint([MESHES, DATA / "nets/vtm", *folders.values()], *settings, tuple(folders))
    columns = [*KEYS, "seconds", *MEASURES]
    kept = [part for fresh in current.values() if len(part := read(path, columns, fresh))]
    table = pd.concat(kept, ignore_index=True) if kept else pd.DataFrame(columns=[*columns, COLUMN])
    sequences = dataset.indices("validation")[: asked.sequences].tolist()
    missing = {
        number: [s for s in sequences if s not in set(table.loc[table["nets"] == number, "sequence"])]
        for number in asked.counts
    }
    initial = starts(dataset, sequences, params) if any(missing.values()) else None
    for number, left in missing.items():
        if initial is None or not left:
            continue
        nets = loaded(places(number, members))
        reference = normalise(nets.model, MESH, nets.params, validation, stages.normalise)
        usual = assemble(SYSTEMS["main"], DATA, weights, plan, stages.simulate.candidates, members)
        planner = dataclasses.replace(
            usual, members=nets.members, nets=nets.params, best=nets.best, normalisation=reference
        )
        of_predictions = predicted(dataset, initial, nets.nets, stages.evaluate_prediction.batch)
        for first in range(0, len(left), TOGETHER):
            found = planned(dataset, left[first : first + TOGETHER], planner, params)
            found = found.merge(of_predictions, on=comparisons.KEYS, validate="one_to_one")
            table = append(table, found.assign(nets=number, **{COLUMN: current[number]}))
            write(table.sort_values(KEYS), path)
        print(f"{number}: {table.loc[table['nets'] == number, 'error'].mean():.4f}", flush=True)
    write(table.sort_values(KEYS), path)
    # Read again, so that the summary is that of the rounded rows, whichever run computed them.
    table = pd.read_csv(path)
    table = table[table["sequence"].isin(sequences)]
    found = summary(table, training_minutes(sorted(table["nets"].unique()), params, folder.parent))
    write(found, of_all)
    print(found[found["column"].str.endswith("all")].round(4).to_string(index=False))
    draw(found, folder / "ensemble.png")


if __name__ == "__main__":
    main()

"""How much search does a plan need?  python studies/search.py [SEQUENCES] [options]

Plans and executes all tasks of the first validation sequences (default: 5) with system main and searches of different
sizes: different numbers of strains; and, with the strains of params.yaml, different numbers of iterations, strides over
the vertices in the loss, fractions of restarts near the best plan, and the other value of `fold` (whether a first
manipulation must fold the cloth). A row per search and task goes to reports/<scale>/studies/search.csv, with the
seconds per plan of that length and the evaluations of the loss in its search. Existing rows are not computed again;
rows made with other nets or other settings (`fingerprint`) are dropped.

The figure search.png shows, for each plan length, the error, the search failures (the recorded plan has the lower loss)
and the first plan's loss against the number of evaluations of the loss per plan. Seconds exclude the first call of each
length, which compiles; if all sequences are planned in one call, they are NaN. Needs the nets, the normalisation and
the dataset (`dvc repro normalise`).

Options with defaults: `--strains N ..` (16 32 64 128 256 512), `--iterations F ..` (0.5 2, factors of the iterations in
params.yaml), `--stride N ..` (1 4), `--near SHARE ..` (0 0.8). `--draw` only draws the existing rows.
"""

import argparse
import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from fingerprint import COLUMN, append, fingerprint, read, write

from clothkit.dataset import store
from clothkit.episodes.evaluate import try_out
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.session_rows import rows
from clothkit.params import load_params
from clothkit.planning.objective import Weights
from clothkit.planning.planner import artifacts, assemble
from clothkit.planning.search import SearchConfig
from clothkit.planning.systems import SYSTEMS
from clothkit.report.figures.studies import search as draw
from clothkit.runtime.clock import Clock
from clothkit.simulation.executor import make_simulator

OWN = ("strains", "base_iterations", "iterations_per_step", "near")
"""Settings of the gradient optimiser; the others are of the search."""
KEYS = ["strains", "base_iterations", "iterations_per_step", "stride", "near", "fold"]


def value_of(search: SearchConfig, name: str) -> Any:
    """Return the value of one of the KEYS."""
    return getattr(search.optimiser if name in OWN else search, name)


def changed(search: SearchConfig, **values: Any) -> SearchConfig:
    """Return the search with other values of some KEYS."""
    own = {name: value for name, value in values.items() if name in OWN}
    rest = {name: value for name, value in values.items() if name not in OWN}
    optimiser: Any = search.optimiser
    return dataclasses.replace(search, optimiser=dataclasses.replace(optimiser, **own), **rest)


def searches(usual: SearchConfig, asked: argparse.Namespace) -> list[SearchConfig]:
    """Return the searches to compare, the one of params.yaml first."""
    found = [usual, *(changed(usual, strains=count) for count in asked.strains)]
    for factor in asked.iterations:
        # Strains are halved only if the iterations of the last round are a multiple of this.
        optimiser: Any = usual.optimiser
        whole = 2**optimiser.halvings
        base, more = (
            max(round(factor * value_of(usual, name) / whole), 1) * whole
            for name in ("base_iterations", "iterations_per_step")
        )
        found.append(changed(usual, base_iterations=base, iterations_per_step=more))
    found += [changed(usual, stride=stride) for stride in asked.stride]
    found += [changed(usual, near=share) for share in asked.near]
    return [*found, changed(usual, fold=not usual.fold)]


def seconds_per_plan(times: Clock) -> dict[int, float]:
    """Return the seconds per plan by length, without each length's first call, which compiles.

    Lengths with a single call are left out. A call for fewer plans than others is padded to as many, and takes as long.
    """
    found = {}
    for length, calls in times.items():
        if length != "estimates" and len(calls) > 1:
            plans, spent = np.array(calls).T
            found[int(length)] = float(spent[1:].mean() / plans.max())
    return found


def _same(table: pd.DataFrame, of_search: dict[str, Any]) -> np.ndarray:
    """Return a mask of the rows of this search."""
    return np.all([table[name] == value for name, value in of_search.items()], axis=0)


def main() -> None:
    """Run the study and print the mean errors of each search."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=5)
    parser.add_argument("--strains", type=int, nargs="*", default=[16, 32, 64, 128, 256, 512])
    parser.add_argument("--iterations", type=float, nargs="*", default=[0.5, 2])
    parser.add_argument("--stride", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--near", type=float, nargs="*", default=[0, 0.8])
    parser.add_argument("--draw", action="store_true", help="only draw the rows that are there; needs no nets")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    simulate, plan = params.stages.simulate, params.stages.plan
    usual = {name: value_of(plan.search, name) for name in KEYS}
    folder = Path("reports") / params.scale / "studies"
    path = folder / "search.csv"
    if asked.draw:
        table = pd.read_csv(path)
        if "evaluations" not in table:
            parser.error(f"{path}: has no column evaluations, expected rows of today's study; run it without --draw")
        draw(table, usual, folder / "search.png")
        return
    weights = Weights(params.alpha, params.beta, params.gamma)
    data, meshes, members = Path("data"), Path("data/meshes.zarr"), params.ensemble.members
    dataset = store.load(meshes)
    sequences = dataset.indices("validation")[: asked.sequences].tolist()
    folder.mkdir(parents=True, exist_ok=True)
    optimiser: Any = plan.search.optimiser
    others = {**dataclasses.asdict(plan.search), **dataclasses.asdict(optimiser)}
    others = {name: value for name, value in others.items() if name not in [*KEYS, "optimiser"]}
    inputs = [meshes, *artifacts(SYSTEMS["main"], data, members, plan.uncertainty.measure).values()]
    settings = [
        others,
        plan.uncertainty,
        plan.refine,
        plan.batch,
        plan.seed,
        weights,
        simulate.candidates,
        simulate.simulation,
    ]
    current = fingerprint(inputs, *settings)
    table = read(path, [*KEYS, "sequence"], current)
    for size in searches(plan.search, asked):
        of_search = {name: value_of(size, name) for name in KEYS}
        done = set(table.loc[_same(table, of_search), "sequence"])
        missing = sorted(set(sequences) - done)
        if missing:
            sized = dataclasses.replace(plan, search=size)
            planner = assemble(SYSTEMS["main"], data, weights, sized, simulate.candidates, members)
            simulator = make_simulator(simulate)
            annotate = partial(diagnosed, planner=planner)
            sessions, times = try_out(dataset, missing, "validation", planner, simulator, annotate=annotate)
            seconds = seconds_per_plan(times)
            found = rows(sessions, "main").assign(**of_search, **{COLUMN: current})
            found["seconds"] = found["length"].map(seconds)
            found["evaluations"] = found["length"].map(value_of(size, "optimiser").evaluations)
            table = append(table, found)
            write(table, path)
            print(f"{of_search}: {found['error'].mean():.4f}", flush=True)
    print(table.groupby([*KEYS, "length"])[["seconds", "error", "loss"]].mean().round(4).to_string())
    draw(table, usual, folder / "search.png")


if __name__ == "__main__":
    main()

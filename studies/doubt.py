"""What is doubt worth?  python studies/doubt.py [SEQUENCES] [options]

Plans for each task of the first validation sequences (default: 40) with system main, the search of params.yaml, and
each measure of uncertainty (`planning/uncertainty_terms.py`) at several weights alpha, with and without the rule that
first manipulations fold as recorded ones do (`fold`). Plans are executed to their end without a look in between
(`episodes.open_loop`), null checks left out. Alpha 0 is no uncertainty term: with the accuracy term of eq. (13)
(paper), or in cloth lengths (expected).

A row per variant and task goes to reports/<scale>/studies/doubt.csv, where a search failure is a plan with a larger
loss than the recorded manipulations. Means with 95 % bootstrap intervals over sequences go to doubt_summary.csv, with
paired differences (and the p of a sign-flip test) to the paper's objective without doubt (alpha 0) and the same rule;
doubt.png shows them.

`--split test` does the same with test sequences, into doubt_test.csv: for what was chosen before. Then
doubt_test_comparisons.csv has the paired comparisons that the report's first paragraphs tell (`compared`). `--system
b1` plans from true meshes instead, `--system b2` with one net and no doubt. `--measures` and `--alphas` choose
variants: `--measures expected --alphas 0.5 1 2`; `--folds 0` leaves out the rule. `--draw` summarises and draws the
rows that are there. Differences are to the variant that `--against SYSTEM MEASURE ALPHA` names (default: main paper
0). Existing rows are not computed again; those made with other nets, maps or settings (`fingerprint`) are dropped.
Needs the nets, the normalisation, the dataset and the probes (`dvc repro normalise probe`).
"""

import argparse
import dataclasses
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, get_args

import pandas as pd
from fingerprint import COLUMN, append, fingerprint, read, write
from optimisers import KEYS, free_programs, plans_of, pose, rows_of

from clothkit.dataset import store
from clothkit.dataset.store import STEPS, Dataset
from clothkit.episodes.sessions import Execute
from clothkit.evaluation.comparisons import COLUMNS, compare, interval, totals
from clothkit.params import Params, load_params
from clothkit.planning.objective import Weights
from clothkit.planning.planner import Planner, artifacts, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.uncertainty_terms import Measure, UncertaintyConfig
from clothkit.report.figures.doubt_study import doubt as draw
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.simulation.executor import make_simulator

DATA = Path("data")
ALPHAS: dict[Measure, tuple[float, ...]] = {
    "paper": (0.0, 0.01, 1.0),
    "conditional": (0.05, 0.2),
    "support": (0.05, 0.2),
    "expected": (0.0, 0.5, 1.0),
}
"""Weights that are tried. Those of conditional and support are in units of eq. (14)'s range, that of expected is 1."""

VARIANT = ["system", "measure", "alpha", "fold"]
AGAINST: tuple[str, Measure, float] = ("main", "paper", 0.0)
"""System, measure and alpha that the others are compared with, each under its own rule."""

EQ15 = 0.01
"""Weight of eq. (15)'s term, a value of ours that no rows single out (`plan.uncertainty.u_weight`)."""

TOGETHER = 10
"""Sequences after which rows are written."""


class Variant(NamedTuple):
    """What is planned with."""

    system: str
    measure: Measure
    alpha: float
    fold: bool

    @property
    def name(self) -> str:
        """Its name in comparisons."""
        return f"{self.system} {self.measure} {self.alpha:g} {'fold' if self.fold else 'any'}"


def planner_of(variant: Variant, params: Params, data: Path = DATA, members: Sequence[int] | None = None) -> Planner:
    """Return the planner of a variant, with the artifacts under `data`, by default those of params.yaml's ensemble."""
    plan = params.stages.plan
    settings = dataclasses.replace(
        plan,
        search=dataclasses.replace(plan.search, fold=variant.fold),
        uncertainty=UncertaintyConfig(measure=variant.measure, u_weight=1.0),
    )
    weights = Weights(variant.alpha, params.beta, params.gamma)
    chosen = params.ensemble.members if members is None else members
    return assemble(SYSTEMS[variant.system], data, weights, settings, params.stages.simulate.candidates, chosen)


def in_force(params: Params) -> tuple[Any, ...]:
    """Return the settings that rows depend on, without those that variants change."""
    plan = params.stages.plan
    search = dataclasses.replace(plan.search, fold=False)
    return search, plan.refine, plan.batch, plan.seed, params.beta, params.gamma


def planned(
    planner: Planner, dataset: Dataset, sequences: list[int], simulator: Execute, name: str, split: str = "validation"
) -> pd.DataFrame:
    """Return a row per task of these sequences."""
    posed = pose(planner, dataset, sequences, split)
    optimisers: dict[int, Any] = {each.length: planner.settings.search.optimiser for each in posed}
    return rows_of(plans_of(planner, optimisers, posed, name), posed, simulator)


def summary(table: pd.DataFrame, against: tuple[str, Any, float] = AGAINST) -> pd.DataFrame:
    """Return means per variant and column of the tables, with intervals and differences to `against`."""
    names: Any = table[VARIANT].itertuples(index=False)
    # The comparisons call what they compare systems.
    named, found = table.assign(system=[Variant(*row).name for row in names]), []
    keys: Any
    for keys, own in table.groupby(VARIANT, sort=False):
        variant = Variant(*keys)
        reference = Variant(*against, variant.fold)
        failures = {part.column: part.mean for part in totals(own, "search_failure")}
        apart = pd.DataFrame()
        if variant != reference and (named["system"] == reference.name).any():
            apart = compare(named, "error", variant.name, reference.name).set_index("column")
        for part in totals(own, "error"):
            low, high = interval(part.total, part.tasks)
            row: dict[str, Any] = {
                **variant._asdict(),
                "column": part.column,
                "sequences": len(part.total),
                "error": part.mean,
                "low": low,
                "high": high,
                "search_failures": failures[part.column],
            }
            if part.column in apart.index:
                pair = apart.loc[part.column]
                row |= {f"difference{end}": pair[name] for end, name in ENDS.items()}
            found.append(row)
    columns = [*VARIANT, "column", "sequences", "error", "low", "high", *(f"difference{end}" for end in ENDS)]
    return pd.DataFrame(found).reindex(columns=[*columns, "search_failures"])


ENDS = {"": "difference", "_low": "low", "_high": "high", "_p": "p"}


def compared(table: pd.DataFrame, params: Params) -> pd.DataFrame:
    """Return the comparisons that the report tells.

    They are of the planner in force (main) with those that the report calls b3 and b2, which have its accuracy term,
    and with eq. (13) without doubt (eq13); and of eq. (13) with the doubt of eq. (15) (eq15) with the latter. Pairs
    without rows of both are left out, and named in print.
    """
    plan = params.stages.plan
    measure, fold = plan.uncertainty.measure, plan.search.fold
    weight = plan.uncertainty.u_weight if measure == "paper" else 1.0
    variants = {
        "main": Variant("main", measure, params.alpha * weight, fold),
        "b3": Variant("main", measure, 0.0, fold),
        "b2": Variant("b2", measure, 0.0, fold),
        "eq13": Variant("main", "paper", 0.0, fold),
        "eq15": Variant("main", "paper", EQ15, fold),
    }
    named = pd.concat(
        [table[(table[VARIANT] == list(variant)).all(axis=1)].assign(system=name) for name, variant in variants.items()]
    )
    pairs = [("main", "b3"), ("main", "b2"), ("main", "eq13"), ("eq15", "eq13")]
    found = []
    for pair in pairs:
        if absent := [variants[name].name for name in pair if name not in set(named["system"])]:
            print(f"{' and '.join(pair)} are not compared: no rows of {' and '.join(absent)}")
        else:
            found.append(compare(named, "error", *pair))
    return pd.concat(found) if found else pd.DataFrame(columns=list(COLUMNS))


def conclude(table: pd.DataFrame, path: Path, against: tuple[str, Any, float], params: Params) -> None:
    """Write and print the summary, and draw it, beside the rows at `path`."""
    found = summary(table, against)
    write(found, path.with_name(f"{path.stem}_summary.csv"))
    shown = found[found["column"].isin([f"{length}/all" for length in range(1, STEPS + 1)])]
    print(shown.drop(columns=["low", "high"]).round(4).to_string(index=False))
    draw(shown, path.with_suffix(".png"))
    if (table["split"] == "test").all():
        write(compared(table, params), path.with_name(f"{path.stem}_comparisons.csv"))


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=40)
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--system", choices=("main", "b1", "b2"), default="main")
    parser.add_argument("--measures", nargs="+", choices=get_args(Measure), default=get_args(Measure))
    parser.add_argument("--alphas", type=float, nargs="+", help="instead of the usual ones")
    parser.add_argument(
        "--folds", type=int, nargs="+", choices=(0, 1), default=(1, 0), help="with the rule (1), without"
    )
    parser.add_argument("--against", nargs=3, default=AGAINST, metavar=("SYSTEM", "MEASURE", "ALPHA"))
    parser.add_argument("--draw", action="store_true", help="only summarise and draw the rows that are there")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    folder, ending = Path("reports") / params.scale / "studies", "_test" if asked.split == "test" else ""
    path, against = folder / f"doubt{ending}.csv", (*asked.against[:2], float(asked.against[2]))
    if asked.draw:
        conclude(pd.read_csv(path), path, against, params)
        return
    simulate = params.stages.simulate
    ensure_jax_cache(Path(".work/compiled"))
    dataset = store.load(DATA / "meshes.zarr")
    sequences = dataset.indices(asked.split)[: asked.sequences].tolist()
    folder.mkdir(parents=True, exist_ok=True)
    # The same for all systems: main needs all that any of them needs.
    inputs = [DATA / "meshes.zarr", *artifacts(SYSTEMS["main"], DATA, params.ensemble.members, "expected").values()]
    current = fingerprint(inputs, in_force(params), simulate.candidates, simulate.simulation)
    table, simulator = read(path, [*VARIANT, *KEYS, "error"], current), make_simulator(simulate)
    chosen = chain.from_iterable([(m, alpha) for alpha in asked.alphas or ALPHAS[m]] for m in asked.measures)
    variants = [Variant(asked.system, *each, bool(fold)) for each in chosen for fold in asked.folds]
    # A system without doubt plans alike with every alpha.
    variants = [each for each in variants if SYSTEMS[each.system].doubts or each.alpha == 0]
    for variant in variants:
        own = table[(table[VARIANT] == list(variant)).all(axis=1)] if len(table) else table
        missing = [sequence for sequence in sequences if sequence not in set(own["sequence"])]
        if not missing:
            continue
        free_programs()
        planner = planner_of(variant, params)
        for first in range(0, len(missing), TOGETHER):
            some = missing[first : first + TOGETHER]
            found = planned(planner, dataset, some, simulator, variant.name, asked.split)
            table = append(table, found.assign(**variant._asdict(), **{COLUMN: current}))
            write(table, path)
    conclude(table, path, against, params)


if __name__ == "__main__":
    main()

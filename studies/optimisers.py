"""Which optimiser finds the best plans through one forward model?  python studies/optimisers.py [SEQUENCES] [options]

Every contestant searches once for a plan for each task of the first validation sequences (default: 30), with system
main: same estimates, candidates, objective and restrictions, and a last exact choice among its best plans. The plans
are executed to their end without a look in between (`episodes.open_loop`), null checks left out. The contestants, each
in its module's words under `planning/optimisers`:

gradient           the search of params.yaml, the reference
gradient_paper     the paper's: no screening, restarts at random plans
shooting_500       random shooting with 500 plans, as VCD
shooting, cem, mppi, greedy, hybrid
                   with sizes that fit the budget

The budgets are the reference's, per plan length: as many evaluations of the model (exact ones of the last choice
included; an evaluation with its gradient counts as one, too, though it takes longer), or as many seconds, within 10 %.
Seconds per plan are measured with compiled programs and batches as in params.yaml, in turn with the reference, so that
other load on the machine slows down both. Sizes and their seconds go to reports/<scale>/studies/optimisers_sizes.csv;
`forward` counts evaluations without gradients, `gradients` those with.

A row per contestant, budget (`both` if the size does not depend on it) and task goes to optimisers.csv, where a search
failure is a plan with a larger loss than the recorded manipulations; means with 95 % bootstrap intervals over
sequences, and paired differences to the reference, go to optimisers_summary.csv, and a figure to optimisers.png.

`--no-execute` leaves errors empty; a later run without it executes the same plans, which are kept under .work/studies.
Existing rows and sizes are not computed again; those made with other nets or other settings (`fingerprint`) are
dropped. `--draw` summarises and draws the rows that are there.

`--tune` tries settings of cem, mppi and hybrid (GRIDS) on other validation sequences (numbers 30 to 44), by their mean
loss with the reference's evaluations, and writes optimisers_tuning.csv; TUNED has the settings in force. Needs
the nets, the normalisation and the dataset (`dvc repro normalise`).
"""

import argparse
import dataclasses
import time
from collections.abc import Callable
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd
import pydantic
from fingerprint import COLUMN, append, fingerprint, read, write
from jaxtyping import Float
from tqdm import tqdm

from clothkit.dataset import store
from clothkit.dataset.store import STEPS, Dataset
from clothkit.dataset.tasks import tasks_of
from clothkit.episodes.open_loop import execute_plans, grasp_positions
from clothkit.episodes.record import Tasks, tasks_of_dataset
from clothkit.episodes.sensors import exact_sensor
from clothkit.episodes.sessions import Execute, search_keys
from clothkit.evaluation.comparisons import compare, interval, totals
from clothkit.evaluation.diagnosis import labels_of_estimates, planning_losses, recorded_plans
from clothkit.evaluation.errors import errors
from clothkit.params import load_params
from clothkit.planning import agent, plans
from clothkit.planning.batches import in_batches, take
from clothkit.planning.objective import Weights
from clothkit.planning.optimisers import AnySettings, evaluations
from clothkit.planning.optimisers.cem import CEMConfig
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.optimisers.greedy import GreedyConfig
from clothkit.planning.optimisers.hybrid import HybridConfig
from clothkit.planning.optimisers.mppi import MPPIConfig
from clothkit.planning.optimisers.random_shooting import RandomShootingConfig
from clothkit.planning.planner import Planner, artifacts, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.types import Found, Problem
from clothkit.report.figures.studies import optimisers as draw
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.runtime.publish import unfinished
from clothkit.runtime.resumable import array_storage, load_piece
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.executor import make_simulator

LENGTHS = tuple(range(1, STEPS + 1))
REFERENCE = "gradient"
FINALISTS = 64
"""Plans among which populations choose exactly in the end: as many as the reference's strains at `laptop`."""

CHUNK = 256
"""Plans that populations evaluate at a time, at most."""

TOGETHER = 15
"""Tasks whose searches are kept in memory at a time."""

TUNING = slice(30, 45)
"""The validation sequences with which settings are tuned, by place."""

TUNED: dict[str, dict[str, float]] = {
    "cem": {"elites": 0.05, "iterations": 10},
    "mppi": {"temperature": 0.05, "std": 0.25, "iterations": 10},
    "hybrid": {"first": 0.3, "strains": 32},
}
"""Settings that `--tune` chose at `laptop` (reports/laptop/studies/optimisers_tuning.csv)."""

GRIDS: dict[str, dict[str, tuple[float, ...]]] = {
    "cem": {"elites": (0.05, 0.1, 0.2), "iterations": (5, 10)},
    "mppi": {"temperature": (0.02, 0.05, 0.2), "std": (0.1, 0.25, 0.5), "iterations": (10,)},
    "hybrid": {"first": (0.3, 0.5, 0.7), "strains": (32, 64)},
}
"""elites: share of a population, VSF's is 0.2; first: share of the evaluations in the first phase."""

SIZES = ["contestant", "budget", "length"]
KEYS = ["sequence", "start", "length"]

TEXT = pydantic.TypeAdapter(AnySettings)
"""Settings as text and back."""

Sizing = Callable[[float, int], Any]
"""evaluations, length -> settings of an optimiser that evaluates about so many plans of this length."""


def population(plans: float, finalists: int = FINALISTS) -> dict[str, int]:
    """Return the settings of a population of about so many plans, divided into equal chunks of at most CHUNK."""
    count = max(round(plans), finalists)
    parts = -(-count // CHUNK)
    chunk = round(count / parts)
    return {"plans": parts * chunk, "chunk": chunk, "finalists": finalists}


def shooting(wanted: float, length: int) -> RandomShootingConfig:
    """Return the size of a random search."""
    return RandomShootingConfig(**population(wanted - FINALISTS))


def greedy(wanted: float, length: int) -> GreedyConfig:
    """Return the size of a greedy search, which divides its evaluations among the steps of a plan."""
    return GreedyConfig(**population((wanted - FINALISTS) / length))


def cem(wanted: float, length: int, *, elites: float, iterations: float) -> CEMConfig:
    """Return the sizes of the cross-entropy method."""
    sizes = population((wanted - FINALISTS) / iterations)
    return CEMConfig(**sizes, iterations=int(iterations), elites=max(1, round(elites * sizes["plans"])))


def mppi(wanted: float, length: int, *, temperature: float, std: float, iterations: float) -> MPPIConfig:
    """Return the sizes of MPPI."""
    sizes = population((wanted - FINALISTS) / iterations)
    return MPPIConfig(**sizes, iterations=int(iterations), temperature=temperature, std=std)


def hybrid(wanted: float, length: int, *, first: float, strains: float, usual: GradientConfig) -> HybridConfig:
    """Return the sizes of five iterations of CEM, then gradient descent of the best plans with two halvings."""
    halvings = 2
    last = dataclasses.replace(
        usual,
        strains=int(strains),
        base_iterations=2**halvings,
        iterations_per_step=0,
        screen=1,
        halvings=halvings,
        polished=min(usual.polished, int(strains) >> halvings),
    )
    rest = wanted - last.finalists
    # Iterations of the last round come in multiples of the smallest number; CEM gets what is left of the budget.
    more = last.evaluations(length)
    each = dataclasses.replace(last, base_iterations=2 * last.base_iterations).evaluations(length) - more
    parts = 1 + max(0, round(((1 - first) * rest - more) / each))
    last = dataclasses.replace(last, base_iterations=parts * last.base_iterations)
    sizes = population((rest - last.evaluations(length)) / 5, last.strains)
    start = CEMConfig(**sizes, iterations=5, elites=max(1, round(0.2 * sizes["plans"])))
    return HybridConfig(phases=(start, last))


def descent(wanted: float, length: int) -> GradientConfig:
    """Return a gradient search by the paper's rules: its step sizes, all starts and restarts at random, no halvings."""
    iterations = max(1, round(wanted / FINALISTS) - 1)
    return GradientConfig(strains=FINALISTS, base_iterations=iterations, iterations_per_step=0)


def tunable(usual: GradientConfig) -> dict[str, Callable[..., Any]]:
    """Return the sizings that take settings of GRIDS."""
    return {"cem": cem, "mppi": mppi, "hybrid": partial(hybrid, usual=usual)}


class Contestant(NamedTuple):
    """An optimiser within a budget."""

    name: str
    budget: str
    """evaluations, seconds, or both if the size does not depend on a budget."""
    sizing: Sizing


def contestants(usual: GradientConfig) -> list[Contestant]:
    """Return all contestants, the reference first."""
    sized: dict[str, Sizing] = {"gradient_paper": descent, "shooting": shooting, "greedy": greedy}
    sized |= {name: partial(sizing, **TUNED[name]) for name, sizing in tunable(usual).items()}
    return [
        Contestant(REFERENCE, "both", lambda wanted, length: usual),
        Contestant("shooting_500", "both", lambda wanted, length: RandomShootingConfig(plans=500, chunk=250)),
        *(Contestant(name, budget, sizing) for budget in ("evaluations", "seconds") for name, sizing in sized.items()),
    ]


def gradients(settings: Any, length: int) -> int:
    """Return how many of a search's evaluations need a backward pass."""
    if isinstance(settings, HybridConfig):
        return sum(gradients(phase, length) for phase in settings.phases)
    if isinstance(settings, GradientConfig):
        moved = sum(strains * iterations for strains, iterations in settings.rounds(length))
        return moved + settings.polish * settings.finalists
    return 0


class Posed(NamedTuple):
    """The problems of all tasks of one length, posed once for all contestants."""

    length: int
    tasks: Tasks
    candidates: Float[np.ndarray, "task candidate 2"]
    problems: Problem
    keys: plans.Keys
    loss_recorded: Float[np.ndarray, " task"]


def pose(planner: Planner, dataset: Dataset, sequences: list[int], split: str = "validation") -> list[Posed]:
    """Return the first problems of the sessions of all tasks, by length."""
    representation, found = planner.representation, []
    for length in LENGTHS:
        chosen = [task for s in sequences for task in tasks_of(s, int(dataset.length[s])) if task.length == length]
        if not chosen:
            continue
        tasks = tasks_of_dataset(dataset, chosen, split)
        goals = representation.of_meshes(np.asarray(tasks.goal, np.float32))
        memory = agent.begin(planner, goals, np.full(len(chosen), length), tasks.cloths.cloth)
        observation, _ = exact_sensor(planner.perception)(np.asarray(tasks.start, np.float32), None)
        state, candidates = agent.perceive(planner, observation, memory)
        problems = plans.pose(planner, state, candidates, memory, length)
        keys = search_keys(tasks, np.arange(len(chosen)), 0, planner.settings.seed)
        labels = labels_of_estimates(representation, state, tasks.start, tasks.cloths.cloth)
        recorded = recorded_plans(representation, tasks.recorded or [], labels)
        loss = planning_losses(planner, state, goals, recorded, tasks.cloths.cloth, candidates, keys)
        found.append(Posed(length, tasks, candidates, problems, keys, loss))
    return found


def only(posed: list[Posed], sequences: set[int]) -> list[Posed]:
    """Return the problems of these sequences."""
    found = []
    for each in posed:
        rows = np.array([row for row, task in enumerate(each.tasks.task) if task.sequence in sequences], int)
        if len(rows):
            some = each.tasks
            tasks = Tasks(
                [some.task[row] for row in rows],
                [some.split[row] for row in rows],
                *take((some.start, some.centre, some.goal, some.cloths), rows),
            )
            candidates, problems, keys, loss = take(
                (each.candidates, each.problems, each.keys, each.loss_recorded), rows
            )
            found.append(Posed(each.length, tasks, candidates, problems, keys, loss))
    return found


def with_optimiser(planner: Planner, optimiser: Any) -> Planner:
    """Return the planner with another optimiser."""
    search = dataclasses.replace(planner.settings.search, optimiser=optimiser)
    return dataclasses.replace(planner, settings=dataclasses.replace(planner.settings, search=search))


def searches(planner: Planner, posed: Posed, bar: tqdm) -> list[tuple[slice, Found]]:
    """Return what the planner's optimiser finds, for TOGETHER tasks at a time, with their rows."""
    search, found = partial(planner.search, length=posed.length), []
    for first in range(0, len(posed.keys), TOGETHER):
        rows = slice(first, first + TOGETHER)
        problems, keys = take((posed.problems, posed.keys), rows)
        found.append((rows, in_batches(search, planner.settings.batch, problems, keys)))
        bar.update(len(keys))
    return found


def free_programs() -> None:
    """Drop all compiled programs: some hundred of them need more memory mappings than a process may have."""
    jax.clear_caches()


class Plans(NamedTuple):
    """The plans that a contestant found, a row per task; steps after a plan's end are NaN."""

    sequence: np.ndarray
    start: np.ndarray
    length: np.ndarray
    manipulation: Float[np.ndarray, "task planned 6"]
    position: Float[np.ndarray, "task planned 2 2"]
    """Where the hands grasp, on the table."""
    loss: Float[np.ndarray, " task"]
    expected: Float[np.ndarray, " task"]


STORAGE = array_storage(Plans)


def plans_of(planner: Planner, optimisers: dict[int, Any], posed: list[Posed], name: str) -> Plans:
    """Search with an optimiser per length, and return the plans."""
    parts = []
    free_programs()
    with tqdm(total=sum(len(each.keys) for each in posed), desc=name, unit="plan") as bar:
        for each in posed:
            own = with_optimiser(planner, optimisers[each.length])
            for rows, found in searches(own, each, bar):
                plan = plans.conclude(own, take(each.problems, rows), found, each.candidates[rows])
                position = grasp_positions(own, plan, each.tasks.centre[rows])
                sequence, start, length = np.array(each.tasks.task[rows]).T
                parts.append(Plans(sequence, start, length, plan.manipulations, position, plan.loss, plan.expected))
    return Plans(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def rows_of(plans: Plans, posed: list[Posed], simulator: Execute | None) -> pd.DataFrame:
    """Return a row per task; errors [cloth length] are NaN without a simulator."""
    start, centre, goal = (
        np.concatenate([getattr(each.tasks, name) for each in posed]) for name in ("start", "centre", "goal")
    )
    cloths = Cloths(*(np.concatenate(parts) for parts in zip(*(each.tasks.cloths for each in posed), strict=True)))
    error = np.full(len(goal), np.nan)
    if simulator:
        outcome = execute_plans(start, centre, plans.manipulation, plans.position, simulator, cloths)
        error = np.asarray(errors(outcome, goal, aligned=True, cloth=cloths.cloth))
    recorded = np.concatenate([each.loss_recorded for each in posed])
    return pd.DataFrame(
        {
            "split": [split for each in posed for split in each.tasks.split],
            **{name: getattr(plans, name) for name in KEYS},
            "loss": plans.loss,
            "loss_recorded": recorded,
            "search_failure": (recorded < plans.loss).astype(int),
            "expected": plans.expected,
            "error": error,
            "error_no_action": np.asarray(errors(start, goal, aligned=True, cloth=cloths.cloth)),
        }
    )


def timed(planner: Planner, reference: Planner, posed: Posed) -> tuple[float, float]:
    """Return the seconds per plan of both planners in one batch, compiled before.

    The first number is the median of two calls, with one of the reference in between.
    """
    batch = planner.settings.batch
    problems, keys = take((posed.problems, posed.keys), np.arange(batch) % len(posed.keys))

    def call(each: Planner) -> float:
        started = time.perf_counter()
        jax.block_until_ready(each.search(problems, keys, length=posed.length))
        return (time.perf_counter() - started) / batch

    call(reference), call(planner)
    before, against, after = call(planner), call(reference), call(planner)
    return float(np.median([before, after])), against


def size(
    contestant: Contestant, planner: Planner, usual: GradientConfig, posed: Posed, start: float | None
) -> dict[str, Any]:
    """Return a contestant's settings for plans of one length as text, with their evaluations and seconds.

    For as many seconds, sizes are tried until seconds differ by at most 8 %, from `start` evaluations on.
    """
    length = posed.length
    reference = with_optimiser(planner, usual)
    wanted = start or float(evaluations(usual, length))
    for _ in range(TRIES):
        settings = contestant.sizing(wanted, length)
        seconds, against = timed(with_optimiser(planner, settings), reference, posed)
        if contestant.budget != "seconds" or 0.92 < seconds / against < 1.08:
            break
        wanted *= against / seconds
    count, backward = evaluations(settings, length), gradients(settings, length)
    return {
        **dict(zip(SIZES, (contestant.name, contestant.budget, length), strict=True)),
        "evaluations": count,
        "forward": count - backward,
        "gradients": backward,
        "seconds": seconds,
        "seconds_reference": against,
        "settings": TEXT.dump_json(settings).decode(),
    }


TRIES = 6
"""Most sizes that are tried for one that takes as many seconds."""


def sized(
    table: pd.DataFrame, planner: Planner, usual: GradientConfig, posed: list[Posed], current: str, path: Path
) -> pd.DataFrame:
    """Return the table with the sizes of all contestants, and write it after each that is new."""
    for contestant, each in product(contestants(usual), posed):
        known = table.set_index(SIZES).sort_index()
        if (contestant.name, contestant.budget, each.length) in known.index:
            continue
        start = None
        if (contestant.name, "evaluations", each.length) in known.index:
            before: Any = known.xs((contestant.name, "evaluations", each.length))
            start = float(before["evaluations"] * before["seconds_reference"] / before["seconds"])
        free_programs()
        found = size(contestant, planner, usual, each, start)
        table = append(table, pd.DataFrame([{**found, COLUMN: current}]))
        write(table, path)
        print({name: value for name, value in found.items() if name != "settings"}, flush=True)
    return table


def summary(table: pd.DataFrame, sizes: pd.DataFrame) -> pd.DataFrame:
    """Return means per contestant, budget and plan length, with intervals and differences to the reference.

    search_failures are shares; low and high are 95 % bootstrap intervals over sequences, p is that of a sign-flip test.
    The reference's own differences, and all that rests on errors that are missing, are NaN.
    """
    measures = {"error": "error", "search_failure": "search_failures"}
    columns = {title: [f"{title}{ending}" for ending in ENDINGS] for title in measures.values()}
    reference = table[table["contestant"] == REFERENCE].assign(system=REFERENCE)
    found: list[pd.DataFrame] = []
    for (name, budget), own in table.groupby(["contestant", "budget"], sort=False):
        rows = own.groupby("length")[["loss", "expected", "error_no_action"]].mean()
        rows.insert(0, "tasks", own.groupby("length").size())
        rows = rows.reindex(columns=["tasks", *chain(*columns.values()), *rows.columns[1:]])
        pairs = pd.concat([reference, own.assign(system=str(name))])
        for column, title in measures.items():
            for part in totals(own.dropna(subset=column), column):
                if part.column.endswith("/all"):
                    values = (part.mean, *interval(part.total, part.tasks))
                    rows.loc[int(part.column[0]), columns[title][:3]] = values
            for row in () if name == REFERENCE else compare(pairs, column, str(name), REFERENCE).itertuples():
                if str(row.column).endswith("/all"):
                    apart: Any = (row.difference, row.low, row.high, row.p)
                    rows.loc[int(str(row.column)[0]), columns[title][3:]] = apart
        rows = rows.reset_index()
        rows.insert(0, "contestant", str(name))
        rows.insert(1, "budget", str(budget))
        found.append(rows)
    return pd.concat(found, ignore_index=True).merge(sizes.drop(columns=["settings", COLUMN]), on=SIZES, how="left")


ENDINGS = ("", "_low", "_high", "_difference", "_difference_low", "_difference_high", "_p")
"""Of the columns of a measure in the summary."""


def tune(
    planner: Planner, usual: GradientConfig, dataset: Dataset, sequences: list[int], path: Path, base: str
) -> None:
    """Try all settings of GRIDS by the mean loss of their plans; write and print the results."""
    posed = pose(planner, dataset, sequences)
    current = fingerprint([], base, sequences, GRIDS)
    table = read(path, ["optimiser", "settings"], current)
    sizings = tunable(usual)
    for name, grid in GRIDS.items():
        for values in product(*grid.values()):
            chosen = dict(zip(grid, values, strict=True))
            text = " ".join(f"{key}={value:g}" for key, value in chosen.items())
            if ((table["optimiser"] == name) & (table["settings"] == text)).any():
                continue
            found = []
            free_programs()
            with tqdm(total=sum(len(each.keys) for each in posed), desc=f"{name} {text}", unit="plan") as bar:
                for each in posed:
                    settings = sizings[name](evaluations(usual, each.length), each.length, **chosen)
                    parts = searches(with_optimiser(planner, settings), each, bar)
                    loss = np.concatenate([part.loss for _, part in parts])
                    failed = each.loss_recorded < loss
                    found.append(pd.DataFrame({"length": str(each.length), "loss": loss, "search_failures": failed}))
            tasks = pd.concat(found)
            tasks = pd.concat([tasks, tasks.assign(length="all")])
            means = tasks.groupby("length", as_index=False).agg(
                tasks=("loss", "size"), loss=("loss", "mean"), search_failures=("search_failures", "mean")
            )
            means = means.assign(optimiser=name, settings=text, **{COLUMN: current})
            table = append(
                table, means[["optimiser", "settings", "length", "tasks", "loss", "search_failures", COLUMN]]
            )
            write(table, path)
    overall = table[table["length"] == "all"]
    best = overall.loc[overall.groupby("optimiser")["loss"].idxmin(), ["optimiser", "settings"]]
    chosen_rows = pd.MultiIndex.from_frame(table[["optimiser", "settings"]]).isin(pd.MultiIndex.from_frame(best))
    write(table.assign(chosen=chosen_rows.astype(int)), path)
    print(table.pivot_table(index=["optimiser", "settings"], columns="length", values="loss", sort=False).round(4))
    print(f"chosen, for TUNED:\n{best.to_string(index=False)}")


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=30)
    parser.add_argument("--no-execute", action="store_true", help="only search: errors are left empty")
    parser.add_argument("--tune", action="store_true", help="choose settings on other sequences, and nothing else")
    parser.add_argument("--draw", action="store_true", help="only summarise and draw the rows that are there")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    folder = Path("reports") / params.scale / "studies"
    path, sizes_path = folder / "optimisers.csv", folder / "optimisers_sizes.csv"
    if asked.draw:
        conclude(pd.read_csv(path), pd.read_csv(sizes_path), folder)
        return
    simulate, plan = params.stages.simulate, params.stages.plan
    usual = plan.search.optimiser
    if not isinstance(usual, GradientConfig):
        parser.exit(1, "optimisers: the reference is a gradient search, but params.yaml names another optimiser\n")
    weights = Weights(params.alpha, params.beta, params.gamma)
    data, meshes, members = Path("data"), Path("data/meshes.zarr"), params.ensemble.members
    # Programs that were freed (`free_programs`) need not be compiled again.
    ensure_jax_cache(Path(".work/compiled"))
    dataset = store.load(meshes)
    validation = dataset.indices("validation").tolist()
    folder.mkdir(parents=True, exist_ok=True)
    inputs = [meshes, *artifacts(SYSTEMS["main"], data, members, plan.uncertainty.measure).values()]
    base = fingerprint(inputs, plan, weights, simulate.candidates, simulate.simulation)
    planner = assemble(SYSTEMS["main"], data, weights, plan, simulate.candidates, members)
    if asked.tune:
        tune(planner, usual, dataset, validation[TUNING], folder / "optimisers_tuning.csv", base)
        return
    sequences = validation[: asked.sequences]
    simulator = None if asked.no_execute else make_simulator(simulate)
    posed = pose(planner, dataset, sequences)
    current = fingerprint([], base, TUNED, FINALISTS, CHUNK)
    sizes = sized(read(sizes_path, SIZES, current), planner, usual, posed, current, sizes_path)
    texts = sizes.set_index(SIZES).sort_index()["settings"]
    work = Path(".work/studies/optimisers")
    work.mkdir(parents=True, exist_ok=True)
    marks, tables = {}, {}
    for name, budget, _ in contestants(usual):
        marks[name, budget] = fingerprint([], base, [texts[name, budget, each.length] for each in posed])
        rows = read(path, [*SIZES, *KEYS, "error"], marks[name, budget])
        tables[name, budget] = rows[(rows["contestant"] == name) & (rows["budget"] == budget)]
    for (name, budget), rows in tables.items():
        known = rows if simulator is None else rows.dropna(subset="error")
        missing = [sequence for sequence in sequences if sequence not in set(known["sequence"])]
        if not missing:
            continue
        optimisers = {each.length: TEXT.validate_json(texts[name, budget, each.length]) for each in posed}
        own = only(posed, set(missing))
        kept = work / f"{name}_{budget}_{fingerprint([], marks[name, budget], missing)}.npz"
        if not kept.exists():
            with unfinished(kept) as part:
                STORAGE.save(part, plans_of(planner, optimisers, own, f"{name}, {budget}"))
        found = rows_of(load_piece(kept, STORAGE), own, simulator)
        found.insert(0, "contestant", name)
        found.insert(1, "budget", budget)
        found[COLUMN] = marks[name, budget]
        tables[name, budget] = append(rows[~rows["sequence"].isin(missing)], found)
        write(pd.concat([table for table in tables.values() if len(table)], ignore_index=True), path)
    conclude(pd.concat(list(tables.values()), ignore_index=True), sizes, folder)


def conclude(table: pd.DataFrame, sizes: pd.DataFrame, folder: Path) -> None:
    """Write and print the summary, and draw it."""
    found = summary(table, sizes)
    write(found, folder / "optimisers_summary.csv")
    shown = ["error", "search_failures", "loss", "evaluations", "gradients", "seconds", "seconds_reference"]
    print(found[[*SIZES, *shown]].round(4).to_string(index=False))
    draw(found, folder / "optimisers.png")


if __name__ == "__main__":
    main()

"""What is doubt worth with less data, or with more nets?  python studies/doubt_amount.py [SEQUENCES] [options]

The forward models of the chain are trained again on the first sequences of the training split (`--amounts`, default:
100, 200, 400), and ensembles of more nets (`--counts`, default: 3, 5) on all of it, by the recipe of params.yaml with
as many iterations. VtM is that of the chain, so states are seen as well as ever. For each ensemble there are reference
values, a support model, and a map of expected errors that is fitted to the executed probes, as in the stages
normalise, train_support and probe.

System main then plans for each task of the first validation sequences (default: 20) as in doubt.py, without doubt and
with the expected error, under the rule of params.yaml (`plan.search.fold`) or those of `--folds` (1: with it, 0:
without). A row per ensemble, variant and task goes to reports/<scale>/studies/doubt_amount.csv; means with 95 %
bootstrap intervals over sequences, and paired differences to no doubt with the same nets and rule, to
doubt_amount_summary.csv, and doubt_amount.png shows them. The rank
correlation and the AUROC (error above 0.08) by which the expected error tells the true ones of probes of other
sequences are in the columns `rank` and `auroc`.

Existing rows are not computed again; those made with other nets or settings (`fingerprint`) are dropped. `--train-only`
trains the nets that are missing and ends; `--draw` summarises and draws the rows that are there. Needs the nets, the
dataset and the probes' settings (`dvc repro probe`).
"""

import argparse
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import trained
from doubt import ENDS, TOGETHER, VARIANT, Variant, in_force, planned, planner_of
from doubt import summary as summary_of
from fingerprint import COLUMN, append, fingerprint, read, write
from optimisers import KEYS, free_programs

from clothkit.dataset import store
from clothkit.dataset.augment import augment
from clothkit.dataset.store import STEPS, Dataset
from clothkit.episodes.sessions import Execute
from clothkit.evaluation import probes
from clothkit.evaluation.doubt import WRONG, auroc, rank_correlation
from clothkit.evaluation.probes import Probes, execute_probes, fitted_to, predicted, table
from clothkit.models import ensemble, support_model
from clothkit.models.ensemble import Ensemble
from clothkit.models.support_model import SupportModel
from clothkit.params import Params, load_params
from clothkit.planning import error_map, normalisation
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import Normalisation, normalise
from clothkit.planning.planner import artifacts
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.uncertainty_terms import EXPECTED_ERROR, SUPPORT
from clothkit.report.figures.doubt_study import amounts as draw
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.simulation.executor import make_simulator
from clothkit.training import support_model as support_training

DATA = Path("data")
MESHES, OWN = DATA / "meshes.zarr", DATA / "studies/doubt_amount"
MAIN = SYSTEMS["main"]
PAIR = 2
"""Number of nets that are trained with each amount of data."""
VARIANTS: tuple[tuple[Any, float], ...] = (("expected", 0.0), ("expected", 1.0))
"""Measure and alpha: no doubt, and the expected error; the accuracy term is the same."""
SETTING = ["amount", "nets"]
"""Training sequences and number of nets."""


class Setting(NamedTuple):
    """What an ensemble is trained with."""

    amount: int
    nets: int

    @property
    def data(self) -> Path:
        """The folder of its artifacts, laid out as the chain's."""
        return OWN / f"{self.amount}_{self.nets}"

    @property
    def members(self) -> tuple[int, ...]:
        """Its members."""
        return tuple(range(self.nets))


def settings_of(whole: int, amounts: Sequence[int], counts: Sequence[int]) -> list[Setting]:
    """Return the ensembles: each amount below the whole with two nets, and the whole with two and with each count."""
    less = [Setting(amount, PAIR) for amount in sorted(set(amounts)) if amount < whole]
    return [*less, *(Setting(whole, count) for count in sorted({PAIR, *counts}))]


def first_sequences(training: Dataset, amount: int) -> Dataset:
    """Return the first sequences of the training split."""
    return training.take(slice(0, amount))


def train(setting: Setting, params: Params, dataset: Dataset) -> None:
    """Train the nets of an ensemble that are missing.

    Ensembles of the same amount of data share nets, and those of all of it begin with the chain's.
    """
    whole, validation = dataset.of_split("train"), dataset.of_split("validation")
    part = first_sequences(whole, setting.amount)
    current = fingerprint([MESHES], params.stages.train_pemd, params.stages.augment, setting.amount)
    nets, links = OWN / f"nets_{setting.amount}", {"vtm": DATA / "nets/vtm"}
    for member in setting.members:
        own = DATA / "nets"
        if len(part) < len(whole) or member not in params.ensemble.members:
            own = nets
            trained.train(nets, member, params, lambda: augment(part, params.stages.augment), validation, current)
        links[f"pemd/{member}"] = ensemble.folder(own, "pemd", member)
    for name, place in links.items():
        link = setting.data / "nets" / name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to(place.resolve(), target_is_directory=True)


class Learned(NamedTuple):
    """What an ensemble tells of probes, and what that takes."""

    reference: Normalisation
    support: SupportModel
    rows: pd.DataFrame
    """Those of `probes.table`."""


def learned(nets: Ensemble, part: Dataset, params: Params, dataset: Dataset, executed: Probes) -> Learned:
    """Return the reference values of an ensemble, a support model of `part` and the rows of the executed probes."""
    stages = params.stages
    reference = normalise(nets.model, MESH, nets.params, dataset.of_split("validation"), stages.normalise)
    support = support_training.train(nets.model, nets.best_net.params, part, stages.train_support)
    spread = reference.reference(reference.longest).spread
    cloth, seed = dataset.cloth[executed.sequence], stages.probe.seed
    found = predicted(nets, support, executed, cloth, stages.simulate.candidates, seed=seed)
    return Learned(reference, support, table(executed, found, spread))


def learn(setting: Setting, params: Params, dataset: Dataset, executed: Probes) -> dict[str, float]:
    """Write the reference values, the support model and the map of expected errors of an ensemble.

    Returns how well the map tells the true errors of probes: their rank correlation (`rank`) and AUROC (`auroc`).
    """
    data = setting.data
    nets = ensemble.load(data / "nets", "pemd", setting.members)
    part = first_sequences(dataset.of_split("train"), setting.amount)
    reference, support, rows = learned(nets, part, params, dataset, executed)
    (data / "normalisation").mkdir(exist_ok=True)
    normalisation.save(data / "normalisation/mesh.json", reference, {})
    support_model.save(data / SUPPORT, support)
    error_map.save(data / EXPECTED_ERROR, fitted_to(rows), {})
    rows = rows[rows["expected"].notna()]
    expected, error = rows["expected"].to_numpy(), rows["error"].to_numpy()
    return {"rank": rank_correlation(expected, error), "auroc": auroc(expected, error > WRONG)}


def probes_of(params: Params, dataset: Dataset, simulator: Execute) -> Probes:
    """Return the probes of the stage `probe`, executed once for all studies."""
    simulate, settings = params.stages.simulate, params.stages.probe
    current = fingerprint([MESHES, Path(str(probes.__file__))], simulate, settings)
    pieces = Path(".work/studies/doubt_amount") / current
    return execute_probes(dataset, settings, simulate.candidates, simulator, work=pieces)


def kept(path: Path, current: Mapping[Setting, str]) -> pd.DataFrame:
    """Return the stored rows of these ensembles that have their fingerprints.

    All are read before the first is computed, since what is written replaces the file.
    """
    parts = [read(path, [*SETTING, *VARIANT, *KEYS, "error"], each) for each in current.values()]
    chosen = [part[(part[SETTING] == list(setting)).all(axis=1)] for setting, part in zip(current, parts, strict=True)]
    return pd.concat([part for part in chosen if len(part)] or parts[:1], ignore_index=True)


def missing_of(table: pd.DataFrame, setting: Setting, variant: Variant, sequences: list[int]) -> list[int]:
    """Return the sequences of which there are no rows of this ensemble and variant."""
    own = (table[[*SETTING, *VARIANT]] == [*setting, *variant]).all(axis=1)
    return np.setdiff1d(sequences, table.loc[own, "sequence"]).tolist()


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the means of doubt.py for each ensemble, with `rank` and `auroc`."""
    found: list[pd.DataFrame] = []
    keys: Any
    for keys, own in rows.groupby(SETTING, sort=True):
        told: dict[str, Any] = {**dict(zip(SETTING, keys, strict=True)), **own[["rank", "auroc"]].iloc[0]}
        found.append(summary_of(own, (MAIN.name, *VARIANTS[0])).assign(**told))
    table = pd.concat(found, ignore_index=True)
    return table[[*SETTING, *table.columns.drop([*SETTING])]]


def conclude(rows: pd.DataFrame, folder: Path) -> None:
    """Write and print the summary, and draw it."""
    found = summary(rows)
    write(found, folder / "doubt_amount_summary.csv")
    shown = found[found["column"].isin([f"{length}/all" for length in range(1, STEPS + 1)])]
    ends = [f"difference{end}" for end in ENDS if end in ("_low", "_high")]
    print(shown.drop(columns=["low", "high", *ends]).round(4).to_string(index=False))
    draw(shown, folder / "doubt_amount.png")


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=20)
    parser.add_argument("--amounts", type=int, nargs="*", default=[100, 200, 400])
    parser.add_argument("--counts", type=int, nargs="*", default=[3, 5])
    parser.add_argument("--folds", type=int, nargs="+", choices=(0, 1))
    parser.add_argument("--train-only", action="store_true", help="train the nets that are missing, and end")
    parser.add_argument("--draw", action="store_true", help="only summarise and draw the rows that are there")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    folder = Path("reports") / params.scale / "studies"
    path = folder / "doubt_amount.csv"
    if asked.draw:
        conclude(pd.read_csv(path), folder)
        return
    ensure_jax_cache(Path(".work/compiled"))
    stages, dataset = params.stages, store.load(MESHES)
    settings = settings_of(len(dataset.indices("train")), asked.amounts, asked.counts)
    for setting in settings:
        train(setting, params, dataset)
    if asked.train_only:
        return
    folder.mkdir(parents=True, exist_ok=True)
    simulate = stages.simulate
    simulator = make_simulator(simulate)
    executed = probes_of(params, dataset, simulator)
    sequences = dataset.indices("validation")[: asked.sequences].tolist()
    folds = [bool(fold) for fold in asked.folds or [stages.plan.search.fold]]
    told, current = {}, {}
    for setting in settings:
        told[setting] = learn(setting, params, dataset, executed)
        inputs = [MESHES, *artifacts(MAIN, setting.data, setting.members, "expected").values()]
        current[setting] = fingerprint([each.resolve() for each in inputs], in_force(params), simulate)
    table = kept(path, current)
    for setting, variant in product(settings, [Variant(MAIN.name, *each, fold) for each in VARIANTS for fold in folds]):
        free_programs()
        missing = missing_of(table, setting, variant, sequences)
        for first in range(0, len(missing), TOGETHER):
            planner = planner_of(variant, params, setting.data, setting.members)
            name = f"{setting.amount} sequences, {setting.nets} nets, {variant.name}"
            found = planned(planner, dataset, missing[first : first + TOGETHER], simulator, name)
            columns = {**setting._asdict(), **variant._asdict(), **told[setting], COLUMN: current[setting]}
            table = append(table, found.assign(**columns))
            write(table.sort_values(SETTING, kind="stable"), path)
    conclude(table, folder)


if __name__ == "__main__":
    main()

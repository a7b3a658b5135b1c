"""Do nets of bootstrapped data know better where they are wrong?  python studies/bootstrap.py [--train-only]

Each member of the ensemble of params.yaml is trained again, by the same recipe and from the same key, on as many
training sequences, which are drawn with replacement by a key of its own (as PETS does; Chua et al., NeurIPS 2018). The
nets are kept in data/studies/bootstrap/pemd. For this ensemble (`bootstrap`) and that of the chain (`plain`) there are
reference values, a support model of all training sequences, and a map of expected errors, as in the stages normalise,
train_support and probe; both predict the same executed probes.

reports/<scale>/studies/bootstrap.csv has a row per group of probes (`evaluation/doubt.py`), measure and statistic: the
AUROC by which the measure tells errors above 0.08 (`wrong`), its rank correlation with the error (`rank`), and the mean
of the errors themselves (`mean` of `error`), for both ensembles, with the difference and its 95 % bootstrap interval
over sequences, paired. Each ensemble is scored by its own errors.

Nets are trained again only if the recipe or the data change; an interrupted training resumes. `--train-only` trains the
nets that are missing and ends. Needs the nets and the dataset (`dvc repro train_pemd`).
"""

import argparse
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import trained
from doubt_amount import learned, probes_of
from fingerprint import fingerprint, write

from clothkit.dataset import store
from clothkit.dataset.augment import augment
from clothkit.dataset.store import Dataset
from clothkit.evaluation.doubt import DRAWS, MEASURES, WRONG, auroc, groups, rank_correlation
from clothkit.models import ensemble
from clothkit.params import Params, load_params
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.simulation.executor import make_simulator

DATA = Path("data")
MESHES, OWN = DATA / "meshes.zarr", DATA / "studies/bootstrap"
SEED = 0
"""Of the drawn sequences."""

STATISTICS: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
    "wrong": lambda measure, error: auroc(measure, error > WRONG),
    "rank": rank_correlation,
}


def drawn(training: Dataset, member: int) -> Dataset:
    """Return as many sequences as there are, drawn with replacement by the member's key."""
    key = jax.random.fold_in(jax.random.key(SEED), member)
    return training.take(np.asarray(jax.random.randint(key, (len(training),), 0, len(training))))


def train(member: int, params: Params, dataset: Dataset) -> None:
    """Train a net of the study, unless it is there."""
    settings = params.stages.augment
    current = fingerprint([MESHES], params.stages.train_pemd, settings, SEED, member)
    part = drawn(dataset.of_split("train"), member)
    trained.train(OWN, member, params, lambda: augment(part, settings), dataset.of_split("validation"), current)


def compared(plain: pd.DataFrame, bootstrapped: pd.DataFrame, draws: int = DRAWS) -> pd.DataFrame:
    """Return the statistics of both ensembles, whose rows are of the same probes, and their differences."""
    rng, found = np.random.default_rng(0), []
    sequences = plain["sequence"].unique()
    samples = [rng.choice(sequences, len(sequences)) for _ in range(draws)]
    for (group, one), (_, other) in zip(groups(plain), groups(bootstrapped), strict=True):
        of_sequence, nowhere = one.groupby("sequence").indices, np.zeros(0, int)
        drawn_rows = [np.concatenate([of_sequence.get(s, nowhere) for s in sample]) for sample in samples]
        told = [name for name in MEASURES if one[name].notna().all() and other[name].notna().all()]
        scores = [(name, statistic, STATISTICS[statistic]) for name, statistic in product(told, STATISTICS)]
        for measure, name, statistic in [("error", "mean", lambda _, error: float(np.mean(error))), *scores]:
            values = [(rows[measure].to_numpy(), rows["error"].to_numpy()) for rows in (one, other)]
            first, second = (statistic(*each) for each in values)
            apart = [
                statistic(*(part[rows] for part in values[1])) - statistic(*(part[rows] for part in values[0]))
                for rows in drawn_rows
                if len(rows)
            ]
            low, high = np.nanquantile(apart, [0.025, 0.975]) if np.isfinite(apart).any() else (np.nan, np.nan)
            row: dict[str, Any] = {"group": group, "measure": measure, "statistic": name}
            row |= {"plain": first, "bootstrap": second, "difference": second - first, "low": low, "high": high}
            found.append(row)
    return pd.DataFrame(found)


def main() -> None:
    """Run the study and print its rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train-only", action="store_true", help="train the nets that are missing, and end")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    ensure_jax_cache(Path(".work/compiled"))
    dataset, members = store.load(MESHES), params.ensemble.members
    for member in members:
        train(member, params, dataset)
    if asked.train_only:
        return
    executed = probes_of(params, dataset, make_simulator(params.stages.simulate))
    training = dataset.of_split("train")
    plain, bootstrapped = (
        learned(ensemble.load(nets, "pemd", members), training, params, dataset, executed).rows
        for nets in (DATA / "nets", OWN)
    )
    found = compared(plain, bootstrapped)
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    write(found, folder / "bootstrap.csv")
    print(found[found["group"] == "all"].round(4).to_string(index=False))


if __name__ == "__main__":
    main()

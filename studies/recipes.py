"""Which recipe trains the forward model better in the same time?  python studies/recipes.py [iterations]

Trains a forward model at the scale in force with the scale's own recipe, its schedule shortened to so many iterations
(500 if not said), then with `recipe: paper` (batches of 64, the paper's rate) and with that at ten times the rate, for
as many CPU seconds each, compilation and validation included. Writes the validation scores to
reports/<scale>/studies/recipes.csv. Needs `dvc repro augment`.
"""

import dataclasses
import sys
import tempfile
import time
from pathlib import Path

import jax
import pandas as pd

from clothkit.dataset import store
from clothkit.dataset.store import Dataset
from clothkit.networks.pemd_training import problem, sequences
from clothkit.networks.settings import TrainingConfig, TrainPEMDConfig
from clothkit.networks.training import train
from clothkit.params import load_params

CHECKS = 10


class TimeIsUp(Exception):
    """Ends a training whose time is used up."""


def curve(settings: TrainPEMDConfig, learn: Dataset, validate: Dataset, *, budget: float = float("inf")) -> list[dict]:
    """A row per validation: iteration, CPU seconds since the start and score, until `budget` CPU seconds are spent."""
    whole = problem(settings, sequences(validate))
    started = time.process_time()
    rows: list[dict] = []

    def timed(params: object) -> dict[str, float]:
        errors = whole.validate(params)
        spent = time.process_time() - started
        iteration = settings.training.validate_every * (len(rows) + 1)
        rows.append({"iteration": iteration, "cpu_seconds": round(spent, 1), "score": errors["score"]})
        if spent > budget:
            raise TimeIsUp
        return errors

    with tempfile.TemporaryDirectory() as work:
        try:
            key = jax.random.key(settings.training.seed)
            watched = dataclasses.replace(whole, validate=timed)
            train(watched, sequences(learn), settings.training, work=Path(work), key=key)
        except TimeIsUp:
            pass
    return rows


def main(iterations: int) -> None:
    """Write one row per recipe and validation, and print the best of each recipe."""
    params = load_params(Path("params.yaml"))
    settings = params.stages.train_pemd
    learn = store.load(Path("data/augmented.zarr"))
    validate = store.load(Path("data/meshes.zarr")).of_split("validation")
    fast = dataclasses.replace(settings.training, iterations=iterations, validate_every=iterations // CHECKS)
    paper = TrainingConfig(recipe="paper", validate_every=iterations // CHECKS, steps_per_call=fast.steps_per_call)
    rows = [
        {"recipe": fast.recipe, **row} for row in curve(dataclasses.replace(settings, training=fast), learn, validate)
    ]
    budget = rows[-1]["cpu_seconds"]
    for name, rate in (("paper", 5e-5), ("paper, 10 x rate", 5e-4)):
        training = dataclasses.replace(paper, learning_rate=rate)
        found = curve(dataclasses.replace(settings, training=training), learn, validate, budget=budget)
        rows += [{"recipe": name, **row} for row in found]
    table = pd.DataFrame(rows)
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "recipes.csv", index=False, lineterminator="\n")
    best = {"iterations": ("iteration", "max"), "cpu_seconds": ("cpu_seconds", "max"), "score": ("score", "min")}
    print(table.groupby("recipe", sort=False).agg(**best).to_string())


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)

"""Which recipe trains the forward model faster?  python studies/recipes.py [seconds]

Trains net a's configuration at the scale in force with `recipe: paper` (batches of 64, the paper's rate), with the same
at ten times the rate, and with the scale's own recipe, each for the same time, and writes the validation scores against
seconds to reports/<scale>/studies/recipes.csv. Needs `dvc repro augment`.
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


class TimeIsUp(Exception):
    """Ends a training whose time is used up."""


def recipes(settings: TrainPEMDConfig) -> dict[str, TrainingConfig]:
    """The recipes that are compared, by name."""
    fast = settings.training
    paper = TrainingConfig(recipe="paper", validate_every=200, steps_per_call=fast.steps_per_call, seed=fast.seed)
    return {"paper": paper, "paper, 10 x rate": dataclasses.replace(paper, learning_rate=5e-4), fast.recipe: fast}


def curve(
    settings: TrainPEMDConfig, training: TrainingConfig, data: tuple[Dataset, Dataset], seconds: float
) -> list[dict]:
    """Validation scores against seconds, compilation and validation included."""
    learn, validate = data
    whole = problem(dataclasses.replace(settings, training=training), sequences(validate))
    started, rows = time.monotonic(), []

    def timed(params: object) -> dict[str, float]:
        errors = whole.validate(params)
        rows.append({"seconds": round(time.monotonic() - started, 1), "score": errors["score"]})
        if time.monotonic() - started > seconds:
            raise TimeIsUp
        return errors

    timed_problem = dataclasses.replace(whole, validate=timed)
    with tempfile.TemporaryDirectory() as work:
        try:
            key = jax.random.key(training.seed)
            train(timed_problem, sequences(learn), training, work=Path(work), key=key)
        except TimeIsUp:
            pass
    every = training.validate_every
    return [{"iteration": every * (i + 1), **row} for i, row in enumerate(rows)]


def main(seconds: float) -> None:
    """Write one row per recipe and validation."""
    params = load_params(Path("params.yaml"))
    settings = params.stages.train_pemd
    data = (
        store.load(Path("data/augmented.zarr")),
        store.load(Path("data/meshes.zarr")).of_split("validation"),
    )
    rows = []
    for name, training in recipes(settings).items():
        rows += [{"recipe": name, **row} for row in curve(settings, training, data, seconds)]
    table = pd.DataFrame(rows)
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "recipes.csv", index=False, lineterminator="\n")
    print(table.groupby("recipe", sort=False).agg(iterations=("iteration", "max"), best=("score", "min")).to_string())


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 420.0)

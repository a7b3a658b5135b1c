"""What does a prediction of a state tell of it, once it is seen?  python studies/expectation.py [SEQUENCES] [options]

The recorded manipulations of the first SEQUENCES validation sequences (default: all) are followed: a state is
estimated from its voxels, the nets of system main predict what a manipulation makes of it, and the next state is
estimated with what was predicted of it, in one of these ways:

seen         not at all: from its voxels alone
start        as in section 5.1 of the paper: refinement starts from the prediction, in its labels
predicted    the prediction is the estimate; nothing is seen
fused F      the prediction, with standard deviations F times those that nets say, is fused with VtM's estimate

A row per way, sequence and step goes to reports/<scale>/studies/expectation.csv: the error of the estimate [cloth
length]. Means, and paired differences to `start` with p of a sign-flip test over sequences, go to
expectation_summary.csv. The nets and the data are those in `--data` (default: data).
"""

import argparse
import dataclasses
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from clothkit.dataset import store
from clothkit.dataset.store import STEPS
from clothkit.estimation.refine import RefineConfig
from clothkit.evaluation.comparisons import interval, sign_flip
from clothkit.evaluation.errors import errors
from clothkit.models.vtm import seen_by
from clothkit.params import load_params
from clothkit.planning.agent import initial_traces
from clothkit.planning.batches import in_batches
from clothkit.planning.objective import Weights
from clothkit.planning.perception import Estimation, Expected, labelled_like
from clothkit.planning.planner import Planner, assemble
from clothkit.planning.plans import expectation
from clothkit.planning.predict import predict
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.types import Observation

SEEN, START, PREDICTED = "seen", "start", "predicted"
FACTORS = (0.5, 1.0, 1.5, 2.0, 3.0)


def ways(settings: RefineConfig) -> dict[str, RefineConfig]:
    """Return the settings of refinement in each way."""
    fused = {f"fused {factor:g}": dataclasses.replace(settings, prior=factor) for factor in FACTORS}
    return {SEEN: settings, START: dataclasses.replace(settings, prior=None), PREDICTED: settings, **fused}


def predicted(planner: Planner, state: np.ndarray, manipulation: np.ndarray, cloth: np.ndarray) -> Expected:
    """Return what the nets predict of the states after one manipulation each."""
    representation = planner.representation

    def both(*batch: Any) -> tuple[np.ndarray, np.ndarray]:
        found = predict(planner.model, representation, planner.nets, *batch)
        states = [one.states for one in found]
        return (
            np.stack([np.asarray(one.mean)[:, 0] for one in states], axis=1),
            np.stack([np.asarray(one.std)[:, 0] for one in states], axis=1),
        )

    plan, common = manipulation[:, None].astype(np.float32), np.zeros(len(state), np.int32)
    traces = initial_traces(planner, len(state))
    return expectation(*in_batches(both, planner.settings.batch, state, traces, plan, common, cloth))


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?")
    parser.add_argument("--data", type=Path, default=Path("data"))
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    stages, weights = params.stages, Weights(params.alpha, params.beta, params.gamma)
    planner = assemble(
        SYSTEMS["main"], asked.data, weights, stages.plan, stages.simulate.candidates, params.ensemble.members
    )
    perception = planner.perception
    assert isinstance(perception, Estimation), "system main estimates what it observes"
    dataset = store.load(asked.data / "meshes.zarr")
    dataset = dataset.take(dataset.indices("validation")[: asked.sequences])
    tables = []
    for name, settings in ways(stages.plan.refine).items():
        eyes = dataclasses.replace(perception, refinement=settings)
        state: np.ndarray | None = None
        following = np.ones(len(dataset), bool)
        for step in range(STEPS + 1):
            following &= dataset.length >= step
            truth, cloth = dataset.vertices[:, step], dataset.cloth
            truth = np.where(following[:, None, None, None], truth, dataset.vertices[:, 0])
            seen = np.concatenate([np.asarray(seen_by(eyes.vtm, part)) for part in np.array_split(truth, 8)])
            expected: Expected | None = None
            if state is not None:
                # Manipulations are recorded in the labels of the true states.
                before = zip(state, dataset.vertices[:, step - 1], cloth, strict=True)
                state = np.stack([labelled_like(*each) for each in before])
                manipulation = np.nan_to_num(dataset.manipulation[:, step - 1])
                expected = predicted(planner, state, manipulation, cloth)
            if name == PREDICTED and expected is not None:
                state = expected.mean
            else:
                state = eyes(Observation(voxels=seen), None if name == SEEN else expected, cloth)
            if step:
                error = np.asarray(errors(state, truth, aligned=True, cloth=cloth))
                row = {"way": name, "sequence": np.arange(len(dataset)), "step": step, "error": error}
                tables.append(pd.DataFrame(row)[following])
    table = pd.concat(tables, ignore_index=True)
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    table.round(5).to_csv(folder / "expectation.csv", index=False, lineterminator="\n")
    print(summary(table, folder / "expectation_summary.csv").round(4).to_string(index=False))


def summary(table: pd.DataFrame, path: Path) -> pd.DataFrame:
    """Return and write the means of each way by step, and what they differ by from `start`."""
    wide = table.pivot_table(index="sequence", columns=["way", "step"], values="error")
    rows = []
    for way, step in product(table["way"].unique(), range(1, STEPS + 1)):
        both = wide[[(way, step), (START, step)]].dropna().to_numpy()
        difference = both[:, 0] - both[:, -1]
        low, high = interval(difference, np.ones(len(both)))
        found = {"difference": difference.mean(), "low": low, "high": high, "p": sign_flip(difference)}
        rows.append({"way": way, "step": step, "sequences": len(both), "error": both[:, 0].mean(), **found})
    result = pd.DataFrame(rows)
    result.to_csv(path, index=False, lineterminator="\n", float_format="%.5g")
    return result


if __name__ == "__main__":
    main()

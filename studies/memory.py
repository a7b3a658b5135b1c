"""Does the memory trace help, which canonical nets reset at each observation?  python studies/memory.py [SEQUENCES]

In section 5.1 a forward model's memory trace is carried over from one plan of a session to the next. A trace of a
canonical net refers to the frame in which the mesh was described; a new observation has another frame, so sessions
reset the trace to zero. This study predicts the results of the recorded manipulations of the first validation sequences
(default: 100) from their true states 1 and 2, at which a session could have a trace, in three ways:

none     the trace is zero, as in sessions with canonical nets
carried  the trace left by the previous manipulations, with its frame replaced by the new state's
frame    the same trace, with the new state described in the frame of the sequence's start, to which the trace refers

A row per way, net and task goes to reports/<scale>/studies/memory_tasks.csv; means and paired comparisons with `none`
(difference, 95 % bootstrap interval and p over sequences) to memory.csv. Needs the nets and the dataset
(`dvc repro train_pemd`).
"""

import argparse
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from fingerprint import write
from jaxtyping import Array, Float, PyTree

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset import store
from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import tasks_of
from clothkit.evaluation.comparisons import compare
from clothkit.models.canonical import Canonicalised, framed, unframed
from clothkit.models.ensemble import Ensemble, load
from clothkit.models.forward import ForwardModel
from clothkit.params import load_params

WAYS = ("none", "carried", "frame")


def encoded_like(
    model: ForwardModel, params: PyTree, mesh: Float[Array, "batch u v 3"], latent: Float[Array, "batch latent"]
) -> Float[Array, "batch latent"]:
    """Return the latent of a mesh in the frame of another latent; for nets that are not canonical, the usual latent."""
    if not isinstance(model, Canonicalised):
        return model.encode(params, mesh)
    _, frame = unframed(latent)
    return framed(model.model.encode(params, model.description.state(mesh, frame)), frame)


def moved(
    model: ForwardModel, trace: Float[Array, "batch latent"], latent: Float[Array, "batch latent"]
) -> Float[Array, "batch latent"]:
    """Return a trace with its frame replaced by that of a latent and its units unchanged."""
    return framed(unframed(trace)[0], unframed(latent)[1]) if isinstance(model, Canonicalised) else trace


def predicted(
    model: ForwardModel,
    params: PyTree,
    states: Float[Array, "batch state u v 3"],
    manipulations: Float[Array, "batch step 6"],
    start: int,
    way: str,
) -> Float[Array, "step batch u v 3"]:
    """Return the means that a net predicts for the states after `start`, with the trace treated in one of the WAYS.

    As in a session, every earlier state is encoded anew, and the trace of each step is passed to the next.
    """
    first = model.encode(params, states[:, 0])
    trace = jnp.zeros_like(first)
    for i in range(start + 1):
        state = states[:, i]
        latent = encoded_like(model, params, state, first) if way == "frame" else model.encode(params, state)
        trace = jnp.zeros_like(latent) if way == "none" or i == 0 else moved(model, trace, latent)
        if i < start:
            _, trace, _ = model.step(params, latent, trace, manipulations[:, i])
    means = []
    for i in range(start, manipulations.shape[1]):
        latent, trace, _ = model.step(params, latent, trace, manipulations[:, i])
        means.append(model.decode(params, latent).mean)
    return jnp.stack(means)


def rows(dataset: Dataset, ensemble: Ensemble, sequences: list[int]) -> pd.DataFrame:
    """Return a row per way, net and task with the labelled error of the predicted mean [cloth length]."""
    chosen = [s for s in sequences if dataset.length[s] == dataset.manipulation.shape[1]]
    states, manipulations = jnp.asarray(dataset.vertices[chosen]), jnp.asarray(dataset.manipulation[chosen])
    found = []
    for member, params in zip(ensemble.members, ensemble.params, strict=True):
        for way in WAYS:
            for start in (1, 2):
                of_way = partial(predicted, ensemble.model, params, start=start, way=way)
                means = jax.jit(of_way)(states, manipulations)
                apart = jnp.linalg.norm(means - jnp.moveaxis(states[:, start + 1 :], 1, 0), axis=-1)
                errors = np.asarray(apart.mean((-2, -1))) / CLOTH_LENGTH
                for place, sequence in enumerate(chosen):
                    for task in tasks_of(sequence, int(dataset.length[sequence])):
                        if task.start == start:
                            error = float(errors[task.length - 1, place])
                            found.append((way, str(member), "validation", sequence, start, task.length, error))
    return pd.DataFrame(found, columns=["system", "net", "split", "sequence", "start", "length", "error"])


def summary(tidy: pd.DataFrame) -> pd.DataFrame:
    """Return means over the nets, by way and column of the tables, with their paired comparisons with `none`."""
    both: pd.DataFrame = tidy.groupby(["system", "split", "sequence", "start", "length"])["error"].mean().reset_index()
    labelled = both.assign(column=both["length"].astype(str) + "/" + both["start"].astype(str))
    means = labelled.groupby(["system", "column"], as_index=False)["error"].mean()
    compared = pd.concat([compare(both, "error", way, "none") for way in WAYS[1:]], ignore_index=True)
    kept = compared[["system", "column", "sequences", "difference", "low", "high", "p"]]
    return means.merge(kept, on=["system", "column"], how="left")


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=100)
    asked = parser.parse_args()
    params, data = load_params(Path("params.yaml")), Path("data")
    dataset = store.load(data / "meshes.zarr")
    ensemble = load(data / "nets", "pemd", params.ensemble.members)
    tidy = rows(dataset, ensemble, dataset.indices("validation")[: asked.sequences].tolist())
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    write(tidy, folder / "memory_tasks.csv")
    found = summary(tidy)
    write(found, folder / "memory.csv")
    print(found.round(5).to_string(index=False))


if __name__ == "__main__":
    main()

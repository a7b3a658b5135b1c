"""What does each part of refinement bring?  python studies/refinement.py [SEQUENCES] [options]

Estimates the states of the first validation sequences (default: 40) by VtM, and refines the estimates in several ways:

mean        VtM's mean, not refined
paper       section 4.7's: likelihood, springs and upward bias; vertices move one by one
observed    and the mesh explains the observed voxels; coarse grids of control points move along, and steps settle
unsure      and where VtM is very unsure, its mean is not given up for springs
chosen      and creases cost little, noise much, and layers are moved apart at the end: what params.yaml says

A row per way and state goes to reports/<scale>/studies/refinement.csv: error [cloth length], intersection over union of
the silhouettes of voxels and estimate and of the voxels themselves, pairs of an edge and a triangle that pierce each
other, and CPU milliseconds per estimate. The means are printed and go to refinement_summary.csv. Nets and data are
those in `--data` (default: data).
"""

import argparse
import dataclasses
import time
from pathlib import Path

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float

from clothkit.dataset import store
from clothkit.dataset.store import STATES
from clothkit.estimation.agreement import agreement
from clothkit.estimation.estimate import estimate, estimate_unrefined
from clothkit.estimation.refine import PAPERS, RefineConfig
from clothkit.evaluation.errors import errors
from clothkit.models import store as nets
from clothkit.models.vtm import seen_by
from clothkit.params import load_params
from clothkit.planning.batches import in_batches
from clothkit.simulation.quality import intersections

BATCH = 20


def ways(chosen: RefineConfig) -> dict[str, RefineConfig | None]:
    """Return the settings of each way; None: not refined."""
    unsure = dataclasses.replace(chosen, bending_weight=0.0, lift=False)
    observed = dataclasses.replace(unsure, slack_weight=1.0, greatest_std=None)
    return {"mean": None, "paper": PAPERS, "observed": observed, "unsure": unsure, "chosen": chosen}


def main() -> None:
    """Run the study, and write and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=40)
    parser.add_argument("--data", type=Path, default=Path("data"))
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    net = nets.load(asked.data / "nets/vtm", "vtm")
    validation = store.load(asked.data / "meshes.zarr").of_split("validation").take(slice(asked.sequences))
    row, state = np.nonzero((np.arange(STATES) <= validation.length[:, None]) & (np.arange(STATES) > 0))
    truth, cloth = validation.vertices[row, state], validation.cloth[row]
    seen = np.asarray(seen_by(net, truth))
    tables = []
    for name, settings in ways(params.stages.plan.refine).items():

        def refined(voxels: np.ndarray, cloth: np.ndarray, settings: RefineConfig | None = settings) -> jax.Array:
            if settings is None:
                return estimate_unrefined(net, voxels, cloth=cloth)
            return estimate(net, voxels, settings, cloth=cloth).mesh

        in_batches(refined, BATCH, seen[:1], cloth[:1])  # A padded batch, which compiles.
        started = time.process_time()
        mesh: Float[np.ndarray, "states u v 3"] = in_batches(refined, BATCH, seen, cloth)
        milliseconds = 1e3 * (time.process_time() - started) / (-(-len(seen) // BATCH) * BATCH)
        agrees = agreement(mesh, seen, viewport=net.config.viewport, forgiven=0)
        columns = {"way": name, "sequence": row, "state": state, "error": np.asarray(errors(mesh, truth, cloth=cloth))}
        columns |= {"silhouette": agrees.silhouette, "heights": agrees.heights, "pierced": intersections(mesh)}
        tables.append(pd.DataFrame(columns | {"milliseconds": milliseconds}))
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    table = pd.concat(tables, ignore_index=True)
    means = table.groupby(["way", "state"], sort=False).mean().drop(columns="sequence").reset_index()
    for frame, file in ((table, "refinement.csv"), (means, "refinement_summary.csv")):
        frame.round(5).to_csv(folder / file, index=False, lineterminator="\n")
    print(means.round(3).to_string(index=False))


if __name__ == "__main__":
    main()

"""Which weight alpha of the uncertainty term is best?  python studies/alpha.py [SEQUENCES] [options]

Plans and executes all tasks of the first validation sequences (default: 10) with one system and the paper's measure of
uncertainty (eq. 15), for several values of alpha, and, with the alpha that params.yaml makes of it (`alpha` times
`plan.uncertainty.u_weight`), for other values of beta and gamma (eqs. 13 and 15). A row per setting and task
goes to reports/<scale>/studies/alpha.csv. Existing rows are not computed again; rows made with other nets or other
settings (`fingerprint`) are dropped. The figure alpha.png shows the error against alpha, beta and gamma for each start
and plan length, as mean and 95 % bootstrap interval over sequences. Needs the nets, the normalisation and the dataset
(`dvc repro normalise`).

Options with defaults: `--alphas A ..` (0 0.003 0.01 0.03 0.1 1 10), `--betas B ..` (2.5 10), `--gammas G ..` (0 2.5),
`--system NAME` (main). The rows and the figure of another system, for instance b1, go to alpha_b1.csv and alpha_b1.png.
`--draw` only draws the existing rows.
"""

import argparse
import dataclasses
from functools import partial
from pathlib import Path

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
from clothkit.planning.systems import SYSTEMS
from clothkit.planning.uncertainty_terms import UncertaintyConfig
from clothkit.report.figures.studies import weights as draw
from clothkit.simulation.executor import make_simulator

NAMES = ("alpha", "beta", "gamma")


def known(table: pd.DataFrame, weights: Weights) -> pd.DataFrame:
    """Return the rows of a table that were made with these weights."""
    return table[np.all([np.isclose(table[name], value) for name, value in weights._asdict().items()], axis=0)]


def main() -> None:
    """Run the study and print the mean errors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", type=int, nargs="?", default=10)
    parser.add_argument("--alphas", type=float, nargs="+", default=[0, 0.003, 0.01, 0.03, 0.1, 1, 10])
    parser.add_argument("--betas", type=float, nargs="*", default=[2.5, 10])
    parser.add_argument("--gammas", type=float, nargs="*", default=[0, 2.5])
    parser.add_argument(
        "--system", choices=[name for name, system in SYSTEMS.items() if system.alpha is None], default="main"
    )
    parser.add_argument("--draw", action="store_true", help="only draw the rows that are there; needs no nets")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    uncertainty = UncertaintyConfig(u_weight=1.0)
    usual = Weights(params.alpha * params.stages.plan.uncertainty.u_weight, params.beta, params.gamma)
    folder = Path("reports") / params.scale / "studies"
    path = folder / ("alpha.csv" if asked.system == "main" else f"alpha_{asked.system}.csv")
    if asked.draw:
        draw(pd.read_csv(path), usual._asdict(), path.with_suffix(".png"))
        return
    settings = [usual._replace(alpha=value) for value in asked.alphas]
    settings += [usual, *(usual._replace(beta=value) for value in asked.betas)]
    settings += [usual._replace(gamma=value) for value in asked.gammas]
    simulate, plan = params.stages.simulate, params.stages.plan
    # Eq. (15) does not tell first displacements that the data do not have; the rule does.
    search = dataclasses.replace(plan.search, fold=True)
    plan = dataclasses.replace(plan, search=search, uncertainty=uncertainty)
    data, meshes, members = Path("data"), Path("data/meshes.zarr"), params.ensemble.members
    dataset = store.load(meshes)
    sequences = dataset.indices("validation")[: asked.sequences].tolist()
    folder.mkdir(parents=True, exist_ok=True)
    name = asked.system
    inputs = [meshes, *artifacts(SYSTEMS[name], data, members, uncertainty.measure).values()]
    current = fingerprint(inputs, plan, simulate.candidates, simulate.simulation)
    table = read(path, [*NAMES, "sequence", "length", "error"], current)
    for weights in settings:
        done = set(known(table, weights)["sequence"])
        missing = [sequence for sequence in sequences if sequence not in done]
        if missing:
            planner = assemble(SYSTEMS[name], data, weights, plan, simulate.candidates, members)
            simulator = make_simulator(simulate)
            annotate = partial(diagnosed, planner=planner)
            sessions, _ = try_out(dataset, missing, "validation", planner, simulator, annotate=annotate)
            found = rows(sessions, name).assign(**weights._asdict(), **{COLUMN: current})
            table = append(table, found)
            write(table, path)
        means = known(table, weights).groupby("length")["error"].mean().round(4).tolist()
        print(f"alpha {weights.alpha:g}, beta {weights.beta:g}, gamma {weights.gamma:g}: {means}", flush=True)
    draw(table, usual._asdict(), path.with_suffix(".png"))


if __name__ == "__main__":
    main()

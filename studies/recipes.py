"""Which training recipe is best for the same CPU time?  python studies/recipes.py NET MINUTES [VARIANT ..] [--seeds ..]

NET is pemd, vtm or emd_voxel. A variant (default: all of VARIANTS[NET]) is the settings of the current scale with the
changes of BASES[NET] and then its own; BASES fixes the settings that variants change, so that a comparison stays the
same when params.yaml changes. For each variant the study measures its time per iteration, computes how many iterations
fit into MINUTES CPU minutes, and trains it with its schedule over them. The validation score after each tenth goes to
reports/<scale>/studies/recipes_<net>.csv with the iterations, the CPU minutes (without compilation and validation), the
variant, its settings and its seed. Existing rows are not computed again; rows made with other data or another base
(`fingerprint`) are dropped. The figure is recipes_<net>.png. Scores of pemd and vtm are in cloth lengths, those of
emd_voxel are mean voxel differences. Needs `dvc repro augment`.
"""

import argparse
import dataclasses
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import pandas as pd
from fingerprint import COLUMN, append, fingerprint, read, write

from clothkit.dataset import store
from clothkit.params import load_params
from clothkit.report.figures.studies import recipes as draw
from clothkit.training import emd_voxel as emd_voxel_training
from clothkit.training import pemd as pemd_training
from clothkit.training import vtm as vtm_training
from clothkit.training.loop import Problem, train

CHECKS = 10
TIMED = 30  # iterations over which a variant's time per iteration is measured
BASE: dict[str, Any] = {"hold": 0.0, "training.muon_iterations": 5, "net.canonical": False, "net.least_std": 0.01}
BASES: dict[str, dict[str, Any]] = {
    "pemd": BASE,
    "vtm": {**BASE, "rare": 0.0},
    "emd_voxel": {"training.muon_iterations": 5, "training.learning_rate": 1e-3, "net.canonical": False},
}
HELD = {"training.muon_iterations": 3, "hold": 0.5}
OWN: dict[str, Any] = {"training.iterations": 1, "training.validate_every": 1, "training.seed": 0}
"""Settings that the study chooses itself; their values in params.yaml have no effect."""
TUNED = {"training.muon_iterations": 3, "training.learning_rate": 3e-3}
FAST = {"training.batch": 512, "training.muon_iterations": 3}
VARIANTS: dict[str, dict[str, dict[str, Any]]] = {
    "pemd": {
        "base": {},
        "paper": {"training.recipe": "paper", "training.batch": 64, "training.learning_rate": 5e-5},
        "paper, 10 x rate": {"training.recipe": "paper", "training.batch": 64, "training.learning_rate": 5e-4},
        "adamw": {"training.muon_width": 0},
        "hold 0.5": {"hold": 0.5},
        "muon 3": {"training.muon_iterations": 3},
        "batch 512": {"training.batch": 512},
        "batch 512, muon 3": FAST,
        "batch 512, muon 3, hold 0.5": {**FAST, "hold": 0.5},
        "muon 3, hold 0.5": HELD,
        "muon 3, hold 1": {**HELD, "hold": 1.0},
        "muon 3, hold 0.5, rates x 2": {**HELD, "training.muon_learning_rate": 1.4e-2, "training.learning_rate": 2e-3},
        "muon 2, hold 0.5": {**HELD, "training.muon_iterations": 2},
        "noise 0.01": {"noise": 0.01},
        "batch 128": {"training.batch": 128},
        "narrower": {"net.manipulation": 192, "net.encoder": [384, 192], "net.decoder": [192, 384]},
        "wider": {"net.latent": 192, "net.manipulation": 384, "net.encoder": [768, 384], "net.decoder": [384, 768]},
        "decay 0.1": {"training.weight_decay": 0.1},
        "rates x 2": {"training.muon_learning_rate": 1.4e-2, "training.learning_rate": 2e-3},
        "rates / 2": {"training.muon_learning_rate": 3.5e-3, "training.learning_rate": 5e-4},
        "noise 0": {"noise": 0.0},
        "start 1": {"training.start.residual": 1.0},
        "hold 1": {"hold": 1.0},
        "muon 3, hold 1, canonical": {**HELD, "hold": 1.0, "net.canonical": True},
        "muon 3, hold 1, canonical, least std 0.003": {
            **HELD,
            "hold": 1.0,
            "net.canonical": True,
            "net.least_std": 0.003,
        },
    },
    "vtm": {
        "base": {},
        "paper": {"training.recipe": "paper", "training.batch": 64, "training.learning_rate": 5e-5},
        "adamw": {"training.muon_width": 0},
        "hold 0.5": {"hold": 0.5},
        "muon 3": {"training.muon_iterations": 3},
        "batch 512": {"training.batch": 512},
        "batch 512, muon 3": FAST,
        "muon 3, hold 0.5": HELD,
        "muon 3, hold 1": {**HELD, "hold": 1.0},
        "batch 512, muon 3, hold 0.5": {**FAST, "hold": 0.5},
        "muon 3, hold 0.5, rates x 2": {**HELD, "training.muon_learning_rate": 1.4e-2, "training.learning_rate": 2e-3},
        "batch 128": {"training.batch": 128},
        "narrower": {"net.hidden": 384},
        "wider": {"net.hidden": 768},
        "decay 0.1": {"training.weight_decay": 0.1},
        "rates x 2": {"training.muon_learning_rate": 1.4e-2, "training.learning_rate": 2e-3},
        "hold 1": {"hold": 1.0},
        "rare 0.001": {"rare": 0.001},
        "muon 3, hold 0.5, rare 0.001": {**HELD, "rare": 0.001},
        "muon 3, hold 0.5, rare 0.001, canonical": {**HELD, "rare": 0.001, "net.canonical": True},
    },
    "emd_voxel": {
        "base": {},
        "paper": {"training.recipe": "paper", "training.learning_rate": 5e-5},
        "adamw": {"training.muon_width": 0},
        "muon 3": {"training.muon_iterations": 3},
        "rate x 3": {"training.learning_rate": 3e-3},
        "muon 3, rate x 3": TUNED,
        "muon 3, rate x 3, muon's x 2": {**TUNED, "training.muon_learning_rate": 1.4e-2},
        "muon 3, rate x 3, batch 32": {**TUNED, "training.batch": 32},
        "muon 3, rate x 3, batch 128": {**TUNED, "training.batch": 128},
        "muon 3, rate x 3, narrower": {**TUNED, "net.width": 0.125},
        "muon 3, rate x 3, canonical": {**TUNED, "net.canonical": True},
    },
}


FORWARD: dict[str, Any] = {"pemd": pemd_training, "emd_voxel": emd_voxel_training}
"""The training modules of forward models, which are trained on sequences; VtM is trained on states."""


class Enough(Exception):
    """Raised to end a training that only measures the time per iteration."""


def changed(settings: Any, changes: Mapping[str, Any]) -> Any:
    """Return the settings with changes applied, given by dotted names."""
    for name, value in changes.items():
        head, _, rest = name.partition(".")
        given = changed(getattr(settings, head), {rest: value}) if rest else value
        settings = dataclasses.replace(settings, **{head: tuple(given) if isinstance(given, list) else given})
    return settings


def learn(settings: Any, problem: Problem, data: Any, *, stop: int = 0) -> list[dict[str, float]]:
    """Train a net and return a row per validation: iteration, CPU minutes without compilation, errors by name.

    With `stop`, the training ends after that many validations.
    """
    rows: list[dict[str, float]] = []
    spent, since = 0.0, None
    every = settings.training.validate_every

    def timed(params: Any) -> dict[str, float]:
        nonlocal spent, since
        now = time.process_time()
        # The first interval includes compilation, so its time is replaced by the mean of the others (below).
        if since is not None:
            spent += now - since
        errors = problem.validate(params)
        rows.append({"iteration": every * (len(rows) + 1), "minutes": spent / 60, **errors})
        if stop and len(rows) == stop:
            raise Enough
        since = time.process_time()
        return errors

    with tempfile.TemporaryDirectory() as work:
        try:
            watched = dataclasses.replace(problem, validate=timed)
            train(watched, data, settings.training, work=Path(work), key=jax.random.key(settings.training.seed))
        except Enough:
            pass
    pace = rows[-1]["minutes"] / max(len(rows) - 1, 1)
    return [{**row, "minutes": row["minutes"] + pace} for row in rows]


def posed(net: str, settings: Any, training: Any, validation: Any) -> tuple[Problem, Any]:
    """Return a net's training problem and training data."""
    if net in FORWARD:
        sequences = pemd_training.sequences
        return FORWARD[net].problem(settings, sequences(validation)), sequences(training)
    states = vtm_training.states(training)
    return vtm_training.problem(settings, validation, vtm_training.taken(states, settings)), states


def study(net: str, settings: Any, minutes: float) -> list[dict[str, Any]]:
    """Train one variant with one seed for `minutes` CPU minutes, and return its rows."""
    meshes = store.load(Path("data/meshes.zarr"))
    learnt = store.load(Path("data/augmented.zarr")) if net in FORWARD else meshes.of_split("train")
    short = changed(settings, {"training.validate_every": TIMED, "training.steps_per_call": 10})
    problem, data = posed(net, short, learnt, meshes.of_split("validation"))
    second = learn(short, problem, data, stop=2)[-1]
    every = max(1, round(minutes / (second["minutes"] / second["iteration"]) / CHECKS))
    whole = changed(settings, {"training.validate_every": every, "training.iterations": CHECKS * every})
    problem, data = posed(net, whole, learnt, meshes.of_split("validation"))
    return learn(whole, problem, data)


def main() -> None:
    """Run the study and print each variant's best score as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("net", choices=list(VARIANTS))
    parser.add_argument("minutes", type=float)
    parser.add_argument("variants", nargs="*", metavar="VARIANT")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    settings = getattr(params.stages, f"train_{asked.net}")
    path = Path("reports") / params.scale / "studies" / f"recipes_{asked.net}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    inputs = [Path("data/meshes.zarr"), *([Path("data/augmented.zarr")] if asked.net in FORWARD else [])]
    current = fingerprint(inputs, changed(settings, {**BASES[asked.net], **OWN}))
    table = read(path, ["budget", "variant", "seed", "changes"], current)
    for seed in asked.seeds:
        for variant in asked.variants or VARIANTS[asked.net]:
            changes = VARIANTS[asked.net][variant]
            known = (table["variant"] == variant) & (table["seed"] == seed) & (table["budget"] == asked.minutes)
            known &= table["changes"] == json.dumps(changes)
            if not known.any():
                wanted = {**BASES[asked.net], **changes, "training.seed": seed}
                rows = study(asked.net, changed(settings, wanted), asked.minutes)
                of = {"budget": asked.minutes, "variant": variant, "changes": json.dumps(changes), "seed": seed}
                table = append(table, pd.DataFrame([{**of, **row, COLUMN: current} for row in rows]))
                write(table, path)
                known = table.index >= len(table) - len(rows)
            best = table[known].sort_values("score").iloc[0]
            print(
                f"{variant}, seed {seed}: {best['score']:.4f} after {best['iteration']:.0f} iterations, "
                f"{best['minutes']:.1f} CPU minutes",
                flush=True,
            )
    # Only rows of this budget are drawn, since scores of different budgets are not comparable.
    unit = "mean voxel difference" if asked.net == "emd_voxel" else "cloth length"
    draw(table[table["budget"] == asked.minutes], path.with_suffix(".png"), unit=unit)


if __name__ == "__main__":
    main()

"""How long does a plan take, and which fraction of the machine's matrix-product rate does the search reach?

python benchmarks/planning.py [SYSTEM ..] [options]

SYSTEM is main, b2, b3, b4 or b5 (default: main, b2, b3). For plans of one, two and three manipulations, the script
prints the seconds per plan, beside the paper's (table 8, RTX 2080 Ti, 256 strains). For systems that plan on meshes, it
also prints the time of the search's matrix products alone, with the same shapes and in the same run, as a fraction of
the search's time. Counted are, for every weight matrix in the loss, the forward product and, in evaluations with a
gradient, the backward product for its input, since weights need no gradient. Exact evaluations count like others. The
encoder, which runs once, is not counted. For `main`, the script also prints the seconds per estimate of a mesh, without
and with refinement, beside those of section 6.1. Rows of systems that plan in voxels are a table of their own.

The objective is the one in force: the system's, with the measure of uncertainty that the scale plans with. Where b3 is
among the systems, the column "of b3's" tells how many times as long a plan takes as without the uncertainty term.

`--scale NAME` selects the sizes of a scale (default: that of params.yaml); `--strains`, `--batch` and `--stride` change
its settings; `--rounds N` (default: 3) is the number of repetitions, of which the shortest time counts. The nets are
untrained, as what measures uncertainty is, since the values of the weights do not affect the time.
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tables import show, write
from timed import device, least

from clothkit.cloth.silhouette import silhouette
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import observe
from clothkit.dataset.store import STEPS
from clothkit.estimation.estimate import estimate, estimate_unrefined
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models import emd_voxel, pemd, support_model, vtm
from clothkit.models.ensemble import Ensemble
from clothkit.models.forward import ForwardModel
from clothkit.models.net import Net
from clothkit.models.settings import SupportModelConfig
from clothkit.params import load_params
from clothkit.planning import error_map
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.initial import EXTENT, RASTER
from clothkit.planning.mesh_representation import CORNERS, MESH
from clothkit.planning.model_error import LEAST, SIGNS
from clothkit.planning.normalisation import Normalisation
from clothkit.planning.objective import Objective, Weights
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.perception import KnownMeshes
from clothkit.planning.planner import Planner
from clothkit.planning.representation import Representation
from clothkit.planning.search import SearchConfig, search
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import SYSTEMS, System
from clothkit.planning.types import UNKNOWN, Candidates, Problem
from clothkit.planning.uncertainty_terms import EXPECTED_ERROR, SUPPORT, terms_of
from clothkit.planning.voxel_representation import VOXEL
from clothkit.report import paper

LENGTHS = (1, 2, 3)
CANDIDATES = 12
ESTIMATION = {"VtM": 0.0037, "refined": 0.5737}
"""The paper's time per estimate (section 6.1), in s."""


def problems(
    model: ForwardModel, representation: Representation, nets: tuple[Any, ...], length: int, batch: int
) -> Problem:
    """Return a batch of problems whose state and goal are the flat cloth."""
    voxels = representation is VOXEL
    state = np.asarray(observe(SQUARE.flat())) if voxels else SQUARE.flat()
    grasps = np.zeros((CANDIDATES, 2), np.float32)
    grasps[: len(CORNERS)] = 0.7 * CORNERS if voxels else CORNERS
    widths = [jax.eval_shape(model.encode, net, jnp.asarray(state)).shape[-1] for net in nets]
    one = Problem(
        state=state,
        goal=state,
        candidates=Candidates(grasps, np.array(len(CORNERS))),
        traces=tuple(np.zeros((representation.labels, width), np.float32) for width in widths),
        relative=np.array(0 if voxels else UNKNOWN),
        later=np.array(False),
        carried=np.zeros((length, 6), np.float32),
        covered=silhouette(SQUARE.flat(), resolution=RASTER, extent=EXTENT),
    )
    return jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], batch, axis=0), one)


@partial(jax.jit, static_argnames="repeats")
def products(x: jax.Array, weights: jax.Array, gradient: jax.Array, *, repeats: int) -> tuple[jax.Array, jax.Array]:
    """Compute a dense layer's forward product and the backward product for its input, `repeats` times.

    Each product is the other's input in the next round, so that the compiler can't remove one. All rounds are one
    program, since starting a program takes longer on a GPU than the products.
    """

    def both(_: int, arrays: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        x, gradient = arrays
        return gradient @ weights.T, x @ weights

    return jax.lax.fori_loop(0, repeats, both, (x, gradient))


def products_alone(params: Any, rows: int, length: int, explicit: bool, every: int, rounds: int) -> tuple[float, float]:
    """Return the seconds and FLOPs of one net's matrix products in one evaluation of the loss."""
    seconds = flops = 0.0
    for path, weights in jax.tree_util.tree_leaves_with_path({part: params[part] for part in "MD"}):
        if weights.ndim != 2:
            continue
        names = [key.key for key in path]
        wide, out = weights.shape
        if names[:2] == ["D", "mesh"]:
            out = out // every**2
        # M runs once per step; D runs for the outcome only, or for every state if the loss has an uncertainty term.
        times, count = (length, rows) if names[0] == "M" else (1, rows * (length if explicit else 1))
        # The weights are scaled so that the products stay of the order of one.
        arrays = (jnp.ones((count, wide)), jnp.full((wide, out), (wide * out) ** -0.5), jnp.ones((count, out)))
        repeats = min(1000, max(1, int(2e9 / (4 * count * wide * out))))
        seconds += times * least(partial(products, *arrays, repeats=repeats), rounds) / repeats
        flops += times * 4 * count * wide * out
    return seconds, flops


def passes(optimiser: Any, length: int) -> float:
    """Return the number of evaluations with a gradient that have as many products as a search; others count half."""
    every = optimiser.evaluations(length)
    if not isinstance(optimiser, GradientConfig):
        return every / 2
    iterations, strains = optimiser.shape(length)
    with_gradient = iterations * strains + optimiser.finalists * optimiser.polish
    return with_gradient + (every - with_gradient) / 2


def in_force(system: System, ensemble: Ensemble, plan: PlanConfig, alpha: float, length: int) -> Objective:
    """Return the objective of a system as `planner.assemble` makes it, of artifacts with any values."""
    settings = plan.uncertainty
    if system.voxels:
        settings = dataclasses.replace(settings, measure="paper")
    weights = Weights(alpha if system.doubts else 0.0, 5.0, 1.25)
    with TemporaryDirectory() as folder:
        data = Path(folder)
        if not system.voxels:
            width = support_model.width_of(ensemble.model, ensemble.best_net.params, SQUARE.flat())
            shown = np.random.default_rng(0).normal(size=(4, width)).astype(np.float32)
            error = ErrorMap(
                SIGNS, np.array(LEAST), np.zeros(STEPS), np.full(len(SIGNS), 0.5), np.ones(1), np.ones((1, 2))
            )
            for place in (SUPPORT, EXPECTED_ERROR):
                (data / place).parent.mkdir(parents=True)
            support_model.save(
                data / SUPPORT, support_model.initial(SupportModelConfig(), shown, key=jax.random.key(0))
            )
            error_map.save(data / EXPECTED_ERROR, error, {})
        accuracy, terms = terms_of(settings, weights.alpha, ensemble, data)
    count, ones = len(ensemble.nets), (1.0,) * length
    spread = ones if count > 1 else ()
    planner = Planner(
        system,
        representation=VOXEL if system.voxels else MESH,
        model=ensemble.model,
        members=ensemble.members,
        nets=ensemble.params,
        best=0,
        perception=KnownMeshes(),
        normalisation=Normalisation(((0.0,) * length,) * count, (ones,) * count, spread, spread),
        weights=weights,
        settings=plan,
        grasping=CandidateConfig(),
        accuracy=accuracy,
        terms=terms,
    )
    return planner.objective(length)


def measure(
    system: System, stages: Any, settings: SearchConfig, batch: int, rounds: int, alpha: float = 1.0
) -> Iterator[dict]:
    """Yield a row of the table for each plan length."""
    net: Any = stages.train_emd_voxel if system.voxels else stages.train_pemd
    build: Any = emd_voxel.initial if system.voxels else pemd.initial
    count = 1 if system.single else 2
    members = tuple(range(count))
    ensemble = Ensemble(members, tuple(Net(net.net, build(net.net, key=jax.random.key(seed))) for seed in members))
    nets, kind = ensemble.params, (ensemble.model, VOXEL if system.voxels else MESH)
    for length in LENGTHS:
        strains = settings.optimiser.shape(length)[1]
        asked = problems(*kind, nets, length, batch)
        keys = jax.random.split(jax.random.key(0), batch)
        objective = in_force(system, ensemble, stages.plan.of(system), alpha, length)
        # States before the outcome are decoded if a term needs them.
        explicit = any(term.every_step for term in objective.terms.values())
        inputs = (nets, asked, objective)
        # Compiled ahead of time, without a first run: at table 1's sizes one search takes minutes on a CPU.
        program = search.lower(*kind, *inputs, length=length, settings=settings, keys=keys).compile()
        seconds = least(partial(program, *inputs, keys=keys), rounds, compiled=True)
        row: dict[str, Any] = {"system": system.name, "device": device(), "strains": strains, "length": length}
        row |= {"s a plan": round(seconds / batch, 3), "paper's": published(system.name, length)}
        if not system.voxels:
            rows = strains * batch
            alone, flops = products_alone(nets[0], rows, length, explicit, settings.stride, rounds)
            evaluations = passes(settings.optimiser, length) / strains * count
            row |= {
                "GF a plan": round(flops * evaluations / batch / 1e9),
                "products s": round(alone * evaluations / batch, 3),
                "GF/s of products": round(flops / alone / 1e9),
                "GF/s of the search": round(flops * evaluations / seconds / 1e9),
                "fraction": f"{alone * evaluations / seconds:.0%}",
            }
        yield row


def with_ratios(rows: list[dict]) -> list[dict]:
    """Return the rows with their seconds as a multiple of b3's of the same length, if b3 is among them."""
    undoubted = {row["length"]: row["s a plan"] for row in rows if row["system"] == "b3"}
    if not undoubted:
        return rows
    return [row | {"of b3's": round(row["s a plan"] / max(undoubted[row["length"]], 1e-3), 2)} for row in rows]


def published(system: str, length: int) -> float | None:
    """Return the paper's time per plan with 256 strains, in s, or None if table 8 has no row for the system."""
    rows = paper.table_of(8, [system])
    rows = rows[rows["machine"].str.contains("2080")]
    return float(rows[str(length)].iloc[0]) if len(rows) else None


def estimates(stages: Any, batch: int, rounds: int) -> list[dict]:
    """Return rows of seconds per estimate, by VtM alone and refined, one at a time (as in the paper) and in a batch."""
    settings = stages.train_vtm.net
    net = Net(settings, vtm.initial(settings, key=jax.random.key(0)))
    found = []
    for count in sorted({1, batch}):
        seen = np.repeat(np.asarray(observe(SQUARE.flat()))[None], count, axis=0)
        calls: dict[str, Callable[[], Any]] = {
            "VtM": partial(estimate_unrefined, net, seen),
            "refined": partial(estimate, net, seen, stages.plan.refine),
        }
        for what, call in calls.items():
            seconds = round(least(call, rounds) / count, 5)
            row = {"estimate": what, "device": device(), "at a time": count, "s each": seconds}
            found.append(row | {"paper's": ESTIMATION[what]})
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("systems", nargs="*", metavar="SYSTEM")
    parser.add_argument("--scale")
    parser.add_argument("--strains", type=int)
    parser.add_argument("--stride", type=int, choices=[n for n in range(1, 33) if SQUARE.shape[0] % n == 0])
    parser.add_argument("--batch", type=int)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--csv", type=Path, metavar="FOLDER", help="write the tables there, too")
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    stages: Any = params.scales[asked.scale or params.scale]
    tables: dict[str, list[dict]] = {}
    names, scale = asked.systems or ("main", "b2", "b3"), asked.scale or params.scale
    for name in names:
        plan = stages.plan.of(SYSTEMS[name])
        settings = plan.search
        if asked.stride is not None:
            settings = dataclasses.replace(settings, stride=asked.stride)
        if asked.strains is not None:
            optimiser: Any = settings.optimiser
            fewer = dataclasses.replace(optimiser, strains=asked.strains)
            settings = dataclasses.replace(settings, optimiser=fewer)
        title = f"planning{' voxels' if SYSTEMS[name].voxels else ''}: {scale}"
        rows = tables.setdefault(title, [])
        for row in measure(SYSTEMS[name], stages, settings, asked.batch or plan.batch, asked.rounds, params.alpha):
            rows.append(row)
            write(title, rows, asked.csv)
    for title, rows in tables.items():
        show(title, with_ratios(rows), csv=asked.csv)
    if "main" in names:
        seconds = estimates(stages, asked.batch or stages.plan.batch, asked.rounds)
        show(f"estimates: {scale}", seconds, csv=asked.csv)


if __name__ == "__main__":
    main()

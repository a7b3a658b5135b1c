"""Which fraction of the machine's matrix-product rate does training reach?  python benchmarks/training.py [NET ..] [..]

NET is pemd or vtm (default: both). The time of a whole training step (sampling, augmentation, voxels, products, update)
is compared with the time of its matrix products alone, with the same shapes and in the same run. Counted are, for every
weight matrix, the forward product and the two of the backward pass (one for a first layer, whose input needs no
gradient), and with recipe `fast` the three of each iteration by which Muon makes its update orthogonal. Steps have the
random lengths of training. The script also prints the time of the optimiser's update alone, and that of the gradient
including the sampling of batches.

`--scale NAME` selects the sizes of a scale (default: that of params.yaml); `--recipe` and `--batch` change its
settings; `--steps N` (default: 12) is the number of steps per call; `--rounds N` (default: 5) is the number of
repetitions, of which the shortest time counts. The data are synthetic, since their values do not affect the time.
"""

import argparse
import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tables import show, write
from timed import device, in_a_row, least

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import STATES, STEPS, Dataset, papers_cloths
from clothkit.params import load_params
from clothkit.training import pemd as pemd_training
from clothkit.training import vtm as vtm_training
from clothkit.training.loop import runner
from clothkit.training.recipe import optimiser
from clothkit.training.settings import TrainingConfig
from clothkit.training.vtm import EVERY

SEQUENCES = 64  # number of synthetic sequences
SHARE = 0.4  # fraction of voxels that `rare: 0.001` keeps for folded cloths; the synthetic cloths are flat


def made_up() -> Dataset:
    """Return a synthetic dataset of flat cloths with noise."""
    random = np.random.default_rng(0)
    vertices = SQUARE.flat() + 0.01 * random.standard_normal((SEQUENCES, STATES, *SQUARE.shape, 3))
    vertices[..., 2] = np.abs(vertices[..., 2])
    return Dataset(
        vertices=vertices.astype(np.float32),
        centre=np.zeros((SEQUENCES, STATES, 2), np.float32),
        manipulation=random.uniform(-0.5, 0.5, (SEQUENCES, STEPS, 6)).astype(np.float32),
        hands=np.ones((SEQUENCES, STEPS), np.int8),
        length=np.full(SEQUENCES, STEPS, np.int8),
        split=np.zeros(SEQUENCES, np.int8),
        evaluated=np.zeros(SEQUENCES, bool),
        **papers_cloths(SEQUENCES)._asdict(),
    )


@partial(jax.jit, static_argnames="first")
def products(x: jax.Array, weights: jax.Array, gradient: jax.Array, *, first: bool) -> tuple[jax.Array, ...]:
    """Compute the forward product of a dense layer and the products of its backward pass."""
    forward, of_weights = x @ weights, x.T @ gradient
    return (forward, of_weights) if first else (forward, of_weights, gradient @ weights.T)


def products_alone(shapes: dict[tuple[int, int, int, bool], int], rounds: int) -> tuple[float, float]:
    """Return the seconds and FLOPs of a step's matrix products.

    `shapes` maps (rows, in, out, first) to the number of layers with this shape; `first` marks first layers.
    """
    seconds = flops = 0.0
    for (rows, wide, out, first), count in shapes.items():
        x, weights, gradient = (jnp.ones(shape) for shape in ((rows, wide), (wide, out), (rows, out)))
        # A single call is too short to be timed, so many calls in a row are.
        repeats = max(1, int(2e9 / (6 * rows * wide * out)))
        row = partial(in_a_row, partial(products, x, weights, gradient, first=first), repeats)
        seconds += count * least(row, rounds) / repeats
        flops += count * (2 if first else 3) * 2 * rows * wide * out
    return seconds, flops


def shapes_of(params: Any, batch: int, n: int) -> dict[tuple[int, int, int, bool], int]:
    """Return the shapes of the matrix products of a step over n manipulations (1 for VtM), with their counts."""
    found: dict[tuple[int, int, int, bool], int] = {}
    for path, weights in jax.tree_util.tree_leaves_with_path(params):
        if weights.ndim != 2:
            continue
        names = [key.key for key in path]
        repeated = names[0] == "M"
        rows = batch * n if names[0] == "D" else batch
        first = names[:2] in (["E", "layer_1"], ["layer_1", "kernel"])
        shape = (rows, *weights.shape, first)
        found[shape] = found.get(shape, 0) + (n if repeated else 1)
    return found


@jax.jit
def orthogonalising(update: jax.Array) -> tuple[jax.Array, ...]:
    """Compute the products of one iteration of Muon for an update [m, n], m <= n."""
    square = update @ update.T
    return square, square @ square, square @ update


def optimiser_alone(params: Any, training: TrainingConfig, rounds: int) -> tuple[float, float]:
    """Return the seconds and FLOPs of the matrix products of the optimiser's update."""
    if training.recipe == "paper":
        return 0.0, 0.0
    shapes = [w.shape for w in jax.tree.leaves(params) if w.ndim == 2 and max(w.shape) <= training.muon_width]
    seconds = flops = 0.0
    for shape in sorted(set(shapes)):
        m, n = sorted(shape)
        counted = 2 * (2 * m * m * n + m**3)
        repeats = max(1, int(2e9 / counted))
        count = training.muon_iterations * shapes.count(shape)
        seconds += (
            count * least(partial(in_a_row, partial(orthogonalising, jnp.ones((m, n))), repeats), rounds) / repeats
        )
        flops += count * counted
    return seconds, flops


def lengths_drawn(key: jax.Array, steps: int) -> list[int]:
    """Return the lengths of pEM*D's first batches, with the same random draws as in its training."""
    keys = [jax.random.split(jax.random.fold_in(key, i))[0] for i in range(steps)]
    return [int(jax.random.randint(k, (), 1, STEPS + 1)) for k in keys]


def measure(name: str, settings: Any, rounds: int, steps: int) -> dict:
    """Return a net's row of the table."""
    dataset, key = made_up(), jax.random.key(1)
    if name == "pemd":
        data: Any = pemd_training.sequences(dataset)
        problem = pemd_training.problem(settings, data)
        lengths = lengths_drawn(key, steps)
    else:
        data = vtm_training.states(dataset)
        kept = SHARE if settings.rare else 1.0
        problem = vtm_training.problem(settings, dataset, EVERY[: round(kept * len(EVERY))])
        lengths = [1] * steps
    params = problem.initial(jax.random.key(0))
    rule = optimiser(settings.training)
    alone = flops = 0.0
    for n in sorted(set(lengths)):
        seconds, counted = products_alone(shapes_of(params, settings.training.batch, n), rounds)
        alone, flops = alone + seconds * lengths.count(n) / steps, flops + counted * lengths.count(n) / steps
    of_update, counted = optimiser_alone(params, settings.training, rounds)
    flops += counted
    run = runner(problem, rule, settings.training)
    carried = [jax.tree.map(jnp.array, params), rule.init(params)]

    def step() -> Any:
        carried[0], carried[1], losses = run(carried[0], carried[1], data, key, 0, 1.0, steps)
        return losses

    @jax.jit
    def gradients(params: Any, data: Any) -> Any:
        def body(total: Any, i: jax.Array) -> Any:
            found, _ = problem.gradient(params, data, jax.random.fold_in(key, i))
            return jax.tree.map(jnp.add, total, found), None

        return jax.lax.scan(body, jax.tree.map(jnp.zeros_like, params), jnp.arange(steps))[0]

    update = jax.jit(rule.update)
    state = rule.init(params)
    whole = least(step, rounds) / steps
    return {
        "net": name,
        "device": device(),
        "batch": settings.training.batch,
        "GF a step": round(flops / 1e9, 1),
        "products ms": round(alone * 1e3, 1),
        "optimiser's products ms": round(of_update * 1e3, 1),
        "gradient ms": round(least(lambda: gradients(params, data), rounds) / steps * 1e3, 1),
        "update ms": round(least(lambda: update(params, state, params), rounds) * 1e3, 1),
        "step ms": round(whole * 1e3, 1),
        "GF/s of products": round(flops / (alone + of_update) / 1e9),
        "GF/s of the step": round(flops / whole / 1e9),
        "fraction": f"{(alone + of_update) / whole:.0%}",
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("nets", nargs="*", metavar="NET")
    parser.add_argument("--scale")
    parser.add_argument("--recipe")
    parser.add_argument("--batch", type=int)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    stages = params.scales[asked.scale or params.scale]
    rows: list[dict] = []
    title = f"training: {asked.scale or params.scale}"
    for name in asked.nets or ("pemd", "vtm"):
        settings: Any = {"pemd": stages.train_pemd, "vtm": stages.train_vtm}[name]
        changed = {k: getattr(asked, k) for k in ("recipe", "batch") if getattr(asked, k) is not None}
        settings = dataclasses.replace(settings, training=dataclasses.replace(settings.training, **changed))
        rows.append(measure(name, settings, asked.rounds, asked.steps))
        write(title, rows, asked.csv)
    show(title, rows, csv=asked.csv)


if __name__ == "__main__":
    main()

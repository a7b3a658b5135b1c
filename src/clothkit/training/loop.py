"""The training loop for all nets: iterations, validation, selection of the best weights, and resuming (section 4.6)."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pandas as pd
from jaxtyping import PRNGKeyArray, PyTree
from tqdm import tqdm

from clothkit.runtime.errors import InputError
from clothkit.training import checkpoint
from clothkit.training.devices import on_all
from clothkit.training.recipe import optimiser, rate
from clothkit.training.settings import TrainingConfig

CHECKPOINT = "training.msgpack"


@dataclass(frozen=True)
class Problem:
    """A learning problem, as three pure functions."""

    initial: Callable[[PRNGKeyArray], PyTree]
    """key -> weights."""
    gradient: Callable[[PyTree, PyTree, PRNGKeyArray], tuple[PyTree, dict[str, Any]]]
    """weights, data, key -> gradient (or sign sum) on a random batch, losses by name."""
    validate: Callable[[PyTree], dict[str, float]]
    """weights -> errors on the validation split by name [cloth length, or mean voxel difference]. The best weights are
    those with the lowest `score`."""


@dataclass
class Progress:
    """The state of a training run besides its arrays. It can be written as JSON, for checkpoints."""

    iteration: int = 0
    halvings: int = 0
    unimproved: int = 0
    best: float = float("inf")
    history: list[dict[str, float | int]] = field(default_factory=list)


@dataclass(frozen=True)
class Trained:
    """The weights with the best validation score, that score, and a history with a row per validation."""

    params: PyTree
    score: float
    history: pd.DataFrame


def train(problem: Problem, data: PyTree, training: TrainingConfig, *, work: Path, key: PRNGKeyArray) -> Trained:
    """Train for the given number of iterations, or until the rate is below `stop_below`.

    If the folder `work` has a checkpoint, training resumes from it. A run that was interrupted and resumed gives the
    same bytes as one that was not. Raises InputError if a loss is not finite.
    """
    rule = optimiser(training)
    params = problem.initial(jax.random.fold_in(key, 0))
    arrays: PyTree = (params, rule.init(params), params)
    progress = Progress()
    if (work / CHECKPOINT).exists():
        arrays, notes = checkpoint.read(work / CHECKPOINT, arrays)
        progress = Progress(**notes)
    # Copies, because `run` donates its arguments' memory, and the first best weights are the same arrays as `params`.
    params, state, best = on_all(jax.tree.map(jnp.array, arrays))
    del arrays
    data = on_all(data)
    run = runner(problem, rule, training)
    key = jax.random.fold_in(key, 1)
    with tqdm(total=training.iterations, initial=progress.iteration, unit="it", smoothing=0.05) as bar:
        while not _finished(progress, training):
            due = min(
                training.iterations,
                progress.iteration - progress.iteration % training.validate_every + training.validate_every,
            )
            losses = []
            while progress.iteration < due:
                count = min(training.steps_per_call, due - progress.iteration)
                params, state, mean = run(params, state, data, key, progress.iteration, 0.5**progress.halvings, count)
                losses.append((count, {name: float(value) for name, value in mean.items()}))
                progress.iteration += count
                bar.update(count)
                bar.set_postfix({**losses[-1][1], "validation": progress.best}, refresh=False)
            best = _judge(problem, training, progress, params, best, _mean(losses))
            checkpoint.write(work / CHECKPOINT, (params, state, best), vars(progress))
    return Trained(best, progress.best, pd.DataFrame(progress.history))


def _finished(progress: Progress, training: TrainingConfig) -> bool:
    stopped = training.recipe == "paper" and training.learning_rate * 0.5**progress.halvings < training.stop_below
    return stopped or progress.iteration >= training.iterations


def runner(problem: Problem, rule: optax.GradientTransformation, training: TrainingConfig) -> Callable[..., Any]:
    """A jitted function that runs `count` iterations: weights, state, .. -> weights, state, mean losses.

    The key is an argument, so that members of an ensemble, which differ in their keys alone, share a compiled program.
    """

    def iterate(
        data: PyTree, key: PRNGKeyArray, factor: Any, carry: tuple[PyTree, PyTree], iteration: Any
    ) -> tuple[Any, Any]:
        params, state = carry
        # The key depends on the iteration's number only, so that a resumed run draws the same batches.
        gradient, losses = problem.gradient(params, data, jax.random.fold_in(key, iteration))
        updates, state = rule.update(gradient, state, params)
        params = jax.tree.map(lambda weight, update: weight + factor * update, params, updates)
        return (params, state), losses

    @partial(jax.jit, static_argnames="count", donate_argnums=(0, 1))
    def run(
        params: PyTree, state: PyTree, data: PyTree, key: PRNGKeyArray, first: Any, factor: Any, count: int
    ) -> tuple[Any, Any, Any]:
        body = partial(iterate, data, key, factor)
        with jax.default_matmul_precision(training.precision):
            (params, state), losses = jax.lax.scan(body, (params, state), first + jnp.arange(count))
        return params, state, jax.tree.map(jnp.mean, losses)

    return run


def _mean(losses: list[tuple[int, dict[str, float]]]) -> dict[str, float]:
    counts = [count for count, _ in losses]
    return {name: float(np.average([row[name] for _, row in losses], weights=counts)) for name in losses[0][1]}


def _judge(
    problem: Problem,
    training: TrainingConfig,
    progress: Progress,
    params: PyTree,
    best: PyTree,
    losses: dict[str, float],
) -> PyTree:
    """Validate, append to the history and halve the rate if needed; returns a copy of the best weights so far."""
    if not all(np.isfinite(value) for value in losses.values()):
        raise InputError(
            f"training, iteration {progress.iteration}: expected finite losses, got {losses}; lower the rates"
        )
    errors = problem.validate(params)
    row = {"iteration": progress.iteration, **losses}
    row["learning_rate"] = rate(training, progress.iteration) * 0.5**progress.halvings
    progress.history.append({**row, **errors})
    if errors["score"] < progress.best:
        progress.best, progress.unimproved = errors["score"], 0
        # A copy, because the next call of `run` donates the memory of `params`.
        return jax.tree.map(jnp.copy, params)
    progress.unimproved += 1
    if training.recipe == "paper" and progress.unimproved >= training.patience:
        progress.halvings, progress.unimproved = progress.halvings + 1, 0
    return best

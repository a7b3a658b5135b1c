"""Reference values of the planning loss from the validation split: high, low (eq. 14), mu_v, sigma_v (eq. 15)."""

import dataclasses
import json
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from clothkit.dataset.store import STEPS, Dataset
from clothkit.manipulation.draws import random_manipulations
from clothkit.models.forward import ForwardModel, rollout
from clothkit.planning.batches import in_batches
from clothkit.planning.objective import Range, Reference, mean_difference
from clothkit.planning.predict import padded
from clothkit.planning.representation import Representation
from clothkit.planning.settings import NormaliseConfig
from clothkit.planning.uncertainty import Spread
from clothkit.runtime.errors import InputError
from clothkit.runtime.json_file import read_json

LEAST_SPAN = 0.001
"""Least difference high - low: for nets with little training, random plans may score as well as the recorded ones."""

TOGETHER = 100
"""Batch size: tasks whose outcomes are predicted in one call."""

LEAST_DEVIATION = 0.01
"""Least sigma_v as a share of mu_v: with few validation sequences the measured one may be close to zero."""

LARGEST = 1e9
"""No NLL or difference comes near it: far above, a term of the loss is lost in float32."""

_HOLDS = "low, high, mu and sigma"


@dataclasses.dataclass(frozen=True)
class Normalisation:
    """low and high of eq. (14) per net and plan length 1..3; mu_v and sigma_v of eq. (15) per step 1..3.

    The rows end at the length of the longest validation sequence. A single net differs from no other: its mu and sigma
    are empty. Raises InputError unless all other rows have the same length, all values are finite, low is below high
    and sigma is positive.
    """

    low: tuple[tuple[float, ...], ...]
    """[net][length - 1]: median NLL of the recorded outcome under the recorded manipulations."""
    high: tuple[tuple[float, ...], ...]
    """[net][length - 1]: median NLL of the recorded outcome under random plans."""
    mu: tuple[float, ...]
    """[step - 1]: mean over the tasks of the nets' difference, which is the mean of `diff` over all pairs of nets."""
    sigma: tuple[float, ...]
    """[step - 1]: standard deviation of the same."""

    def __post_init__(self) -> None:
        if not self.low or len(self.low) != len(self.high):
            raise InputError(
                f"normalisation: expected a row of low and one of high for each net, found {len(self.low)} and "
                f"{len(self.high)}"
            )
        if len(self.low) == 1 and (self.mu or self.sigma):
            raise InputError("normalisation: expected no mu and no sigma for a single net, found values")
        rows = (*self.low, *self.high, *((self.mu, self.sigma) if len(self.low) > 1 else ()))
        same = {len(row) for row in rows} == {self.longest} and 1 <= self.longest <= STEPS
        if not same or not np.isfinite(np.array(rows, float)).all():
            raise InputError(
                f"normalisation: expected 1 to {STEPS} finite values in each row of low, high, mu and sigma"
            )
        if np.abs(np.array(rows, float)).max() > LARGEST:
            raise InputError(f"normalisation: expected values up to {LARGEST:g} in low, high, mu and sigma")
        # As the loss takes them.
        low, high, sigma = (np.array(values, np.float32) for values in (self.low, self.high, self.sigma))
        if not (low < high).all():
            raise InputError(f"normalisation: expected low below high, found {self.low} and {self.high}")
        if (sigma <= 0).any():
            raise InputError(f"normalisation: sigma is {self.sigma}, expected above 0: are the nets the same?")

    @property
    def longest(self) -> int:
        """The length of the longest plans with reference values."""
        return len(self.low[0])

    def reference(self, length: int) -> Reference:
        """The reference values for plans of one length, as `search` takes them.

        Raises InputError if no validation sequence is that long.
        """
        if length > self.longest:
            raise InputError(
                f"normalisation: expected reference values for plans of {length} manipulations, found them for up to "
                f"{self.longest}: no validation sequence is longer"
            )
        spans = tuple(
            Range(np.array(low[:length], np.float32), np.array(high[:length], np.float32))
            for low, high in zip(self.low, self.high, strict=True)
        )
        return Reference(
            spans, Spread(np.array(self.mu[:length], np.float32), np.array(self.sigma[:length], np.float32))
        )


def normalise(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    validation: Dataset,
    settings: NormaliseConfig,
) -> Normalisation:
    """Compute the reference values of an ensemble for all lengths up to that of the longest validation sequence.

    For plans of length n, the start state i of eq. (14) runs over 0..3 - n (design 6.9).
    """
    key = jax.random.key(settings.seed)
    low, high, mu, sigma = [], [], [], []
    # The number of tasks of one manipulation: those of more are fewer.
    together, score = min(TOGETHER, int(validation.length.sum())), partial(_scores, model, representation, nets)
    for length in range(1, int(validation.length.max()) + 1):
        tasks = representation.recorded(*_stretches(validation, length))
        cloth = np.repeat(validation.cloth, np.maximum(validation.length - length + 1, 0), axis=0)
        of_nets, apart = in_batches(score, together, tasks.start, tasks.goal, tasks.plan, cloth)
        low.append([float(np.median(scores)) for scores in of_nets])
        if apart is not None:
            mu.append(float(apart.mean()))
            sigma.append(max(float(apart.std()), LEAST_DEVIATION * mu[-1]))
        drawn = []
        for draw in range(settings.draws):
            random = random_manipulations(tasks.plan.shape[:2], key=jax.random.fold_in(key, STEPS * draw + length))
            drawn.append(in_batches(score, together, tasks.start, tasks.goal, np.asarray(random), cloth)[0])
        medians = [float(np.median(np.concatenate(scores))) for scores in zip(*drawn, strict=True)]
        high.append([max(median, least + LEAST_SPAN) for median, least in zip(medians, low[-1], strict=True)])
    return Normalisation(tuple(zip(*low, strict=True)), tuple(zip(*high, strict=True)), tuple(mu), tuple(sigma))


def _stretches(dataset: Dataset, length: int) -> tuple[np.ndarray, np.ndarray]:
    """True states [task n+1 u v 3] and recorded manipulations [task n 6] of all subsequences of n manipulations."""
    pairs = [(d, i) for d in range(len(dataset)) for i in range(int(dataset.length[d]) - length + 1)]
    d, i = np.array(pairs).T
    states = i[:, None] + np.arange(length + 1)
    return dataset.vertices[d[:, None], states], dataset.manipulation[d[:, None], states[:, :-1]]


def _scores(
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    start: Array | np.ndarray,
    goal: Array | np.ndarray,
    plan: Array | np.ndarray,
    cloth: Array | np.ndarray,
) -> tuple[tuple[Array, ...], Array | None]:
    """The accuracy term of each net's predicted outcome, without span, and the difference of the outcomes."""
    steps, plan = np.int32(plan.shape[1]), padded(plan, STEPS)
    found = (_score(model, representation, net, start, goal, plan, cloth, steps) for net in nets)
    scores, outcomes = zip(*found, strict=True)
    return scores, _mean_difference(representation, outcomes)


@partial(jax.jit, static_argnames=("model", "representation"))
def _score(
    model: ForwardModel,
    representation: Representation,
    net: Any,
    start: Array | np.ndarray,
    goal: Array | np.ndarray,
    plan: Array | np.ndarray,
    cloth: Array | np.ndarray,
    steps: Int[Array | np.ndarray, ""] | np.int32,
) -> tuple[Array, Any]:
    """One net's score and its predicted outcome after so many manipulations, by a program that serves all nets."""
    latents = rollout(model, net, model.encode(net, start, cloth), plan).latents
    outcome = model.decode(net, latents[steps - 1])
    return representation.accuracy(representation.target(jnp.asarray(goal)), outcome), outcome


_mean_difference = jax.jit(mean_difference, static_argnames="representation")


def save(path: Path, normalisation: Normalisation, attributes: dict[str, Any]) -> None:
    """Write the reference values and the attributes (the params that they were made with) as JSON."""
    path.write_text(json.dumps({**dataclasses.asdict(normalisation), "attributes": attributes}, indent=1) + "\n")


def load(path: Path) -> Normalisation:
    """Read the values. Raises InputError for a file that is missing, damaged, lacks a field or has none in one."""
    stored = read_json(path, expected=f"JSON with {_HOLDS}; run the stage that writes it (dvc repro)")
    try:
        rows = {name: tuple(_numbers(row) for row in stored[name]) for name in ("low", "high")}
        return Normalisation(**rows, mu=_numbers(stored["mu"]), sigma=_numbers(stored["sigma"]))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: expected JSON with {_HOLDS}, could not read it ({error})") from error


def _numbers(row: Any) -> tuple[float, ...]:
    if not isinstance(row, list) or any(type(value) not in (int, float) for value in row):
        raise TypeError(f"expected a list of numbers, found {row!r:.60}")
    return tuple(float(value) for value in row)

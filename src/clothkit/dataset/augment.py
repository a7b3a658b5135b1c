"""Insertion of null manipulations into training sequences and random rotation, saved as a store (section 4.6)."""

from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Float

from clothkit.dataset.store import SPLITS, STATES, STEPS, Dataset, Parts, load_parts, load_splits
from clothkit.manipulation.sampling import SamplingConfig
from clothkit.manipulation.vector import SHORTEST
from clothkit.runtime.config import config


@config
class AugmentConfig:
    """Number of variants of each training sequence, and the share of them with an inserted null manipulation."""

    variants: Annotated[int, Gt(0)] = 2
    null_share: Annotated[float, Ge(0), Le(1)] = 0.25
    seed: Annotated[int, Ge(0)] = 0


def augment(training: Dataset, settings: AugmentConfig) -> Dataset:
    """Make `variants` copies of every sequence, each rotated and mirrored at random.

    With probability `null_share`, a copy also gets a null manipulation at a random step.
    """
    copies = training.take(np.repeat(np.arange(len(training)), settings.variants))
    return _varied(copies, settings, np.random.default_rng(settings.seed))


def augmented(meshes: Path, settings: AugmentConfig) -> Parts:
    """What `augment` makes of the training split of a store of meshes, one part in memory at a time.

    Raises InputError for a store that is damaged, not as declared, or has values out of range in any split.
    """
    split, _ = load_splits(meshes)
    # All splits are checked, before anything is made: later stages read the others.
    for _ in load_parts(meshes, np.arange(len(split))):
        pass
    copies = np.repeat(np.flatnonzero(split == SPLITS.index("train")), settings.variants)
    rng = np.random.default_rng(settings.seed)
    return Parts(len(copies), (_varied(part, settings, rng) for part in load_parts(meshes, copies)))


def _varied(copies: Dataset, settings: AugmentConfig, rng: np.random.Generator) -> Dataset:
    """The copies, which no one else holds, after their random changes."""
    fields = {name: getattr(copies, name) for name in ("vertices", "centre", "manipulation", "hands", "length")}
    for row in range(len(copies)):
        if rng.random() < settings.null_share:
            _insert_null(fields, row, rng)
        _turn(fields, row, rng)
    return copies


def _insert_null(fields: dict[str, np.ndarray], row: int, rng: np.random.Generator) -> None:
    """Insert a null manipulation at a random step of one row, in place, e.g. (m0, null, m1) with (s0, s1, s1, s2).

    The manipulations from that step on come one step later; if the sequence has full length, the last one is dropped.
    """
    length = int(fields["length"][row])
    step = int(rng.integers(min(length + 1, STEPS)))
    kept_states = np.insert(np.arange(STATES - 1), step, step)
    kept_steps = np.insert(np.arange(STEPS - 1), step, step)
    displaced = fields["manipulation"][row, min(step, length - 1)].copy()
    hands = int(fields["hands"][row, min(step, length - 1)])
    for name, kept in (
        ("vertices", kept_states),
        ("centre", kept_states),
        ("manipulation", kept_steps),
        ("hands", kept_steps),
    ):
        fields[name][row] = fields[name][row][kept]
    if rng.random() < 0.5:
        hands = 1 if rng.random() < SamplingConfig().single_share else 2
        first = rng.uniform(-1, 1, 2)
        displaced[:4] = np.concatenate([first, first if hands == 1 else rng.uniform(-1, 1, 2)])
    displaced[4:] = null_displacement(rng)
    fields["manipulation"][row, step], fields["hands"][row, step] = displaced, hands
    fields["length"][row] = min(length + 1, STEPS)


def null_displacement(rng: np.random.Generator) -> Float[np.ndarray, "2"]:
    """A random displacement, uniform in the disc of null manipulations [normalised]."""
    angle, radius = rng.uniform(0, 2 * np.pi), SHORTEST * np.sqrt(rng.random())
    return radius * np.array([np.cos(angle), np.sin(angle)])


def _turn(fields: dict[str, np.ndarray], row: int, rng: np.random.Generator) -> None:
    angle, mirrored = rng.uniform(0, 2 * np.pi), rng.random() < 0.5
    c, s, sign = np.cos(angle), np.sin(angle), -1 if mirrored else 1
    matrix = np.array([[c * sign, -s], [s * sign, c]], np.float32)
    fields["vertices"][row, ..., :2] = fields["vertices"][row, ..., :2] @ matrix.T
    fields["centre"][row] = fields["centre"][row] @ matrix.T
    fields["manipulation"][row, :, 4:] = fields["manipulation"][row, :, 4:] @ matrix.T

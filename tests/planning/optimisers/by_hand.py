"""Distributions of plans as plain NumPy loops, for transcriptions of published algorithms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.planning.optimisers.bowl import CANDIDATES, PRESENT, index_of


@dataclass
class Distribution:
    """The parameters, indexed [candidate, candidate], [step], [step, hands - 1, component]."""

    pairs: np.ndarray
    single: np.ndarray
    mean: np.ndarray
    variance: np.ndarray


def loss_of(plan: np.ndarray, target: np.ndarray) -> float:
    """The bowl's loss: grasp points in the better order, and displacements."""
    total = 0.0
    for m, t in zip(plan, target, strict=True):
        first, second = m[:2], m[2:4]
        straight = ((first - t[:2]) ** 2).sum() + ((second - t[2:4]) ** 2).sum()
        crossed = ((second - t[:2]) ** 2).sum() + ((first - t[2:4]) ** 2).sum()
        total += min(straight, crossed) + ((m[4:] - t[4:]) ** 2).sum()
    return float(total)


def hands(manipulation: np.ndarray) -> int:
    return 1 if (manipulation[:2] == manipulation[2:4]).all() else 2


def in_order(manipulation: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """The manipulation with its hands in the order nearer to the reference's."""
    crossed = manipulation[[2, 3, 0, 1, 4, 5]]
    nearer = ((crossed - reference)[:4] ** 2).sum() < ((manipulation - reference)[:4] ** 2).sum()
    return crossed if nearer else manipulation


def moments(plans: Sequence[np.ndarray], weights: Sequence[float], before: Distribution | None = None) -> Distribution:
    """Weighted frequencies and moments; hands are put in the order of the plan of the largest weight."""
    length = len(plans[0])
    pairs = np.zeros((len(CANDIDATES), len(CANDIDATES)))
    for plan, weight in zip(plans, weights, strict=True):
        pairs[tuple(sorted(index_of(grasp) for grasp in plan[0, :4].reshape(2, 2)))] += weight
    single = np.zeros(length)
    mean, variance = (np.zeros((length, 2, 6)) if before is None else getattr(before, n).copy() for n in MOMENTS)
    for step in range(length):
        single[step] = sum(w for plan, w in zip(plans, weights, strict=True) if hands(plan[step]) == 1)
        for count in (1, 2):
            chosen = [(plan[step], w) for plan, w in zip(plans, weights, strict=True) if hands(plan[step]) == count]
            total = sum(w for _, w in chosen)
            if total == 0:
                continue
            if count == 2 and before is not None:
                best = in_order(max(chosen, key=lambda each: each[1])[0], before.mean[step, 1])
                chosen = [(in_order(m, best), w) for m, w in chosen]
            mean[step, count - 1] = sum(w * m for m, w in chosen) / total
            variance[step, count - 1] = sum(w * (m - mean[step, count - 1]) ** 2 for m, w in chosen) / total
    whole = sum(weights)
    return Distribution(pairs / whole, single / whole, mean, variance)


MOMENTS = ("mean", "variance")


def pair_at(pairs: np.ndarray, chance: float) -> tuple[int, int]:
    """The pair at which the sum of probabilities passes so much of the whole."""
    so_far = 0.0
    for i in range(PRESENT):
        for j in range(PRESENT):
            so_far += pairs[i, j]
            if pairs[i, j] and chance * pairs.sum() < so_far:
                return i, j
    raise AssertionError


def plan_of(
    distribution: Distribution, pair: tuple[int, int], single: Sequence[bool], noise: np.ndarray, std: np.ndarray
) -> np.ndarray:
    """The plan with these discrete parts and this noise."""
    plan = np.zeros((len(noise), 6))
    for step, one in enumerate(single):
        kind = 0 if one else 1
        plan[step] = distribution.mean[step, kind] + std[step, kind] * noise[step]
        if one:
            plan[step, 2:4] = plan[step, :2]
    plan[0, :4] = CANDIDATES[list(pair)].ravel()
    plan[:, :4] = plan[:, :4].clip(-1, 1)
    return plan


def nominal_plan(distribution: Distribution) -> np.ndarray:
    """The most probable plan."""
    i, j = np.unravel_index(distribution.pairs.argmax(), distribution.pairs.shape)
    length = len(distribution.mean)
    single = [bool(i == j), *(distribution.single[1:] > 0.5)]
    return plan_of(distribution, (int(i), int(j)), single, np.zeros((length, 6)), np.zeros((length, 2, 6)))

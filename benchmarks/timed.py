"""How benchmarks time what JAX runs."""

import time
from collections.abc import Callable
from typing import Any

import jax


def least(call: Callable[[], Any], rounds: int, *, compiled: bool = False) -> float:
    """Seconds of the quickest of some calls, after one that compiles unless they are `compiled`."""
    if not compiled:
        jax.block_until_ready(call())
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - started)
    return min(times)


def in_a_row(call: Callable[[], Any], repeats: int) -> list[Any]:
    """The results of so many calls."""
    return [call() for _ in range(repeats)]

"""Timing of JAX programs for benchmarks."""

import time
from collections.abc import Callable
from typing import Any

import jax


def device() -> str:
    """Return the name of the device that JAX computes on."""
    return str(jax.devices()[0].device_kind)


def least(call: Callable[[], Any], rounds: int, *, compiled: bool = False) -> float:
    """Return the shortest time of `rounds` calls, in s; a first call, which compiles, is excluded unless `compiled`."""
    if not compiled:
        jax.block_until_ready(call())
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - started)
    return min(times)


def in_a_row(call: Callable[[], Any], repeats: int) -> list[Any]:
    """Return the results of `repeats` calls."""
    return [call() for _ in range(repeats)]

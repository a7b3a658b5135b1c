"""Measures how long parts of a computation take, without handing times through it."""

import contextlib
import time
from collections import defaultdict
from collections.abc import Iterator
from contextvars import ContextVar

Clock = dict[str, list[tuple[int, float]]]
"""For each named part, the number of items and the time [s] of each call."""

_running: ContextVar[Clock | None] = ContextVar("clock", default=None)


@contextlib.contextmanager
def clock() -> Iterator[Clock]:
    """Collect the times of all `timed` parts inside."""
    calls: Clock = defaultdict(list)
    token = _running.set(calls)
    try:
        yield calls
    finally:
        _running.reset(token)


@contextlib.contextmanager
def timed(part: str, count: int) -> Iterator[None]:
    """Note the time of what runs inside, for a call that handles `count` items, if a clock runs."""
    started = time.perf_counter()
    yield
    running = _running.get()
    if running is not None:
        running[part].append((count, time.perf_counter() - started))

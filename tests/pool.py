"""A pool without processes."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any


class SerialPool(Executor):
    """A pool that computes at once, in this process, what is submitted."""

    def __init__(self, width: int = 1) -> None:
        self.width = width

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> "Future[Any]":
        done: Future[Any] = Future()
        done.set_result(function(*arguments, **named))
        return done

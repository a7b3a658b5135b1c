"""A pool of workers on a Dask cluster (the package `distributed`), with the interface of `concurrent.futures`.

The cluster schedules, moves and repeats the work; what is added here are sentences for what can go wrong, and that
workers with other code are refused. Results are returned, not stored by workers: a cluster may take a worker for lost
and give its work to another while both still run, and no file may have two writers.
"""

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, contextmanager
from typing import Any

from clothkit.runtime import remote  # here, not in open_dask: see `fingerprint` of that module
from clothkit.runtime.errors import InputError

TRIES = 3
"""Number of workers that a piece may lose before it is given up: the piece itself may end them.

It holds for clusters of this machine's own. A scheduler that was started elsewhere has its own limit, of all its users:
`distributed.scheduler.allowed-failures` in its configuration, which is one less (Dask's default is 3).
"""

_SECONDS = 60  # for which a scheduler's answer is awaited


class DaskPool(Executor):
    """Runs functions on the workers of a cluster. Arguments and results must be picklable.

    The result of a future raises InputError if the scheduler was lost, if a worker has other code, and if the piece
    ended as many workers, one after another, as the scheduler allows (see TRIES).
    """

    def __init__(self, client: Any, expected: str) -> None:
        self._client, self._expected = client, expected
        self._executor = client.get_executor(pure=False)
        self._run = _guarded()

    @property
    def width(self) -> int:
        """The number of workers at the moment, at least 1; a cluster may grow and shrink."""
        return max(1, len(self._client.nthreads())) if self._client.status == "running" else 1

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> "Future[Any]":
        """The future of a call on some worker."""
        from distributed.protocol import pickle  # which pickles functions of scripts, too

        found: Future[Any] = Future()
        payload = pickle.dumps((function, arguments, named))
        inner = self._executor.submit(self._run, self._expected, payload)
        inner.add_done_callback(lambda done: self._settle(done, found))
        return found

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which forgets what it was still to compute for this pool."""
        self._client.close()

    def _settle(self, done: "Future[Any]", found: "Future[Any]") -> None:
        from distributed import KilledWorker

        try:
            refused, value = done.result()
            if refused:
                raise InputError(f"{value}; start the workers again with this code, and run again")
            found.set_result(value)
        except CancelledError:
            lost = InputError(
                f"the Dask scheduler at {_address(self._client)} was lost while it computed; what was finished is "
                "stored: start it and its workers again, and run again"
            )
            found.set_exception(lost)
        except KilledWorker as error:
            ended = InputError(
                f"a piece of work ended {error.allowed_failures + 1} Dask workers one after another, the last at "
                f"{error.last_worker.address}; read the workers' logs (too little memory?)"
            )
            found.set_exception(ended)
        except Exception as error:
            found.set_exception(error)


@contextmanager
def open_dask(address: str, *, workers: int) -> Iterator[DaskPool]:
    """A pool on the cluster whose scheduler is at `address` (`tcp://host:8786`, or a scheduler's file).

    Without an address, Dask's own setting counts (the variable DASK_SCHEDULER_ADDRESS); where there is none, a cluster
    of `workers` processes is started on this machine, and ended afterwards. Raises InputError if `distributed` is not
    installed, and if no scheduler answers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError(f"executor dask needs the package distributed: install clothkit[dask] ({error})") from error
    address = address or dask.config.get("scheduler-address", "") or ""
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": TRIES - 1}))
        if address:
            where: dict[str, Any] = {"scheduler_file": address} if os.path.isfile(address) else {"address": address}
        else:
            # Memory is left to the system: Dask would stop workers that compile kernels.
            own = LocalCluster(n_workers=workers, threads_per_worker=1, memory_limit=0, dashboard_address="127.0.0.1:0")
            where = {"address": stack.enter_context(own)}
        try:
            client = stack.enter_context(Client(**where, timeout=_SECONDS, set_as_default=False))
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(f"no Dask scheduler answers at {address}: is it running? ({reason})") from error
        if not client.nthreads():
            print(f"the Dask scheduler at {_address(client)} has no workers yet; waiting for them", file=sys.stderr)
        yield DaskPool(client, remote.LOADED)


def _address(client: Any) -> str:
    scheduler = client.scheduler
    return str(scheduler.address if scheduler is not None else "an unknown address")


def _guarded() -> Callable[[str, bytes], tuple[bool, Any]]:
    """A function for workers: runs a payload, or tells why the worker is refused.

    It is nested, so that it is sent as code, not as a name: a worker of another version may have no such function.
    """

    def guarded(expected: str, payload: bytes) -> tuple[bool, Any]:
        import socket

        try:
            from clothkit.runtime import remote
        except Exception as error:
            return True, f"a Dask worker on {socket.gethostname()} has no clothkit that runs this ({error})"
        if expected != remote.LOADED:
            return True, (
                f"a Dask worker on {socket.gethostname()} has other code: its fingerprint is {remote.LOADED}, expected "
                f"{expected} (clothkit's sources, and the versions of what it simulates with)"
            )
        return False, remote.run(payload)

    return guarded

"""Recording of sequences in resumable blocks of attempts; the result is the same for any number of workers."""

import math
from collections import Counter
from contextlib import ExitStack
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool
from tqdm import tqdm

from clothkit.cloth.topology import Topology
from clothkit.runtime.errors import InputError
from clothkit.runtime.resumable import array_storage, load_piece, resumable_map
from clothkit.simulation.attempts import Attempts, attempt_sequences
from clothkit.simulation.processes import cores, open_pool
from clothkit.simulation.records import write_raw
from clothkit.simulation.settings import SimulateConfig

TOGETHER = 256  # blocks whose arrays are joined, since a small array takes more memory than what it holds
AHEAD = 2  # blocks in flight per worker
HOPELESS = 200  # fewest rejected attempts in a row after which the recording ends with an error
UNUSUAL = 20  # the same, as a multiple of the mean attempts per accepted sequence so far; the larger number counts

BLOCKS = array_storage(Attempts)
"""Storage of the blocks of attempts in a work directory."""


class Summary(NamedTuple):
    """Statistics of a recording."""

    attempts: int
    accepted: int
    reasons: dict[str, int]
    """Rejected attempts by reason, most frequent first."""
    single_share: float
    """Fraction of the accepted manipulations that are single-handed."""

    def __str__(self) -> str:
        """Return the statistics as one sentence."""
        reasons = ", ".join(f"{name} {count}" for name, count in self.reasons.items()) or "none"
        return (
            f"{self.accepted} of {self.attempts} attempts accepted ({self.accepted / self.attempts:.1%}), "
            f"{self.single_share:.1%} of the manipulations single-handed; rejected: {reasons}"
        )


def generate(
    folder: Path,
    settings: SimulateConfig,
    *,
    work: Path,
    attributes: dict[str, Any],
    topology: Topology | None = None,
) -> Summary:
    """Record `settings.sequences` accepted sequences under `folder`, as raw parquet, and return the statistics.

    Accepted sequences are taken in the order of their attempts' numbers, so `executor`, `workers` and `block` change
    nothing. Blocks are made in parallel by all workers, those of a Dask cluster with `executor: dask`. Finished ones
    are stored in `work`, and an interrupted run resumes from them. Raises InputError if too many attempts in a row are
    rejected (see HOPELESS), or if a cluster is lost. Without a topology, the cloth is the square of
    `settings.simulation`; `work` holds the blocks of one topology alone.
    """
    topology = topology or settings.simulation.topology
    paths: list[Path] = []
    # Without the states, which would fill the memory: they are read again, block by block, when they are written.
    blocks: list[Attempts] = []
    tried = accepted = 0
    rejected: Counter[str] = Counter()  # by reason, since the last attempt that was accepted

    workers = settings.workers or cores()

    def started() -> int:
        """Return how many blocks to have in flight: no more than are likely to be needed.

        The estimate uses the acceptance rate by Laplace's rule, which is one half before the first attempt.
        """
        wanted = (settings.sequences - accepted) / (settings.block * (accepted + 1) / (tried + 2))
        return min(AHEAD * (1 if pool is None else pool.width), math.ceil(wanted))

    with ExitStack() as stack:
        pool = None
        if settings.executor == "dask" or workers > 1:
            pool = stack.enter_context(open_pool(settings.executor, workers=workers, scheduler=settings.scheduler))
        bar = stack.enter_context(
            tqdm(total=settings.sequences, desc="simulate", unit="sequence", mininterval=1, smoothing=0.05)
        )
        finished = resumable_map(
            partial(attempt_sequences, settings=settings, topology=topology),
            (range(number * settings.block, (number + 1) * settings.block) for number in count()),
            folder=work,
            name=f"block_{settings.block}",
            storage=BLOCKS,
            bar=bar,
            count=lambda block: int(block.accepted.sum()),
            pool=pool,
            ahead=started,
        )
        for path, block in finished:
            paths.append(path)
            blocks.append(block._replace(states=block.states[:, :0].copy()))
            if len(blocks) == TOGETHER:
                blocks = [_joined(blocks)]
            tried += len(block.attempt)
            accepted += int(block.accepted.sum())
            if block.accepted.any():
                rejected.clear()
            rejected.update(block.reason[_after_last(block.accepted) :].tolist())
            bar.set_postfix({"yield": f"{accepted / tried:.0%}"}, refresh=False)
            if accepted >= settings.sequences:
                break
            _check_hope(rejected, tried, accepted)
    attempts = _joined(blocks)
    last = np.flatnonzero(np.cumsum(attempts.accepted) == settings.sequences)[0] + 1
    attempts = Attempts(*(array[:last] for array in attempts))
    states = (block.states[block.accepted] for block in (load_piece(path, BLOCKS) for path in paths))
    write_raw(folder, attempts, states, seed=settings.seed, attributes=attributes)
    return summarise(attempts)


def summarise(attempts: Attempts) -> Summary:
    """Return the counts of accepted attempts and of rejected ones by reason."""
    rejected = Counter(attempts.reason[~attempts.accepted].tolist())
    hands = attempts.hands[attempts.accepted]
    single = float((hands == 1).mean()) if hands.size else 0.0
    return Summary(len(attempts.attempt), int(attempts.accepted.sum()), dict(rejected.most_common()), single)


def _joined(blocks: list[Attempts]) -> Attempts:
    return Attempts(*(np.concatenate(arrays) for arrays in zip(*blocks, strict=True)))


def _after_last(accepted: Bool[np.ndarray, " attempts"]) -> int:
    """Return the number of attempts up to the last accepted one."""
    return int(np.flatnonzero(accepted)[-1]) + 1 if accepted.any() else 0


def _check_hope(rejected: Counter[str], tried: int, accepted: int) -> None:
    """Raise InputError if too many attempts in a row were rejected (see HOPELESS), the last ones for these reasons."""
    since = rejected.total()
    if since < max(HOPELESS, UNUSUAL * (tried - since) / max(1, accepted)):
        return
    why = ", ".join(f"{name} {count}" for name, count in rejected.most_common())
    of = f"none of {since} attempted sequences" if since == tried else f"none of the last {since} attempted sequences"
    raise InputError(
        f"params.yaml: simulate.limits accepted {of} ({why}); change simulate.limits, simulate.simulation or "
        "simulate.sampling"
    )

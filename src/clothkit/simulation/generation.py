"""Recording of sequences in resumable blocks of attempts; the result is the same for any number of workers."""

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from clothkit.cloth.topology import Topology
from clothkit.errors import InputError, damaged_piece
from clothkit.simulation.attempts import Attempts, attempt_sequences
from clothkit.simulation.processes import cores, make_pool
from clothkit.simulation.records import write_raw
from clothkit.simulation.settings import SimulateConfig

AHEAD = 2  # blocks in flight per worker
HOPELESS = 200  # fewest rejected attempts in a row after which the recording ends with an error
UNUSUAL = 20  # the same, as a multiple of the mean attempts per accepted sequence so far; the larger number counts


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

    Accepted sequences are taken in the order of their attempts' numbers, so `workers` and `block` change nothing.
    Finished blocks are stored in `work`, and an interrupted run resumes from them. Raises InputError if too many
    attempts in a row are rejected (see HOPELESS). Without a topology, the cloth is the square of `settings.simulation`;
    `work` holds the blocks of one topology alone.
    """
    topology = topology or settings.simulation.topology
    paths: list[Path] = []
    # Without the states, which would fill the memory: they are read again, block by block, when they are written.
    blocks: list[Attempts] = []
    tried = accepted = 0

    def wanted() -> int:
        """Return an estimate of how many more blocks are needed, from the acceptance rate by Laplace's rule.

        The estimated rate is one half before the first attempt.
        """
        return math.ceil((settings.sequences - accepted) / (settings.block * (accepted + 1) / (tried + 2)))

    with tqdm(total=settings.sequences, desc="simulate", unit="sequence", mininterval=1, smoothing=0.05) as bar:
        for path in _finished_blocks(settings, work, wanted, topology):
            block = read_block(path)
            paths.append(path)
            blocks.append(block._replace(states=block.states[:, :0].copy()))
            tried += len(block.attempt)
            accepted += int(block.accepted.sum())
            bar.update(min(accepted, settings.sequences) - bar.n)
            bar.set_postfix({"yield": f"{accepted / tried:.0%}"}, refresh=False)
            if accepted >= settings.sequences:
                break
            _check_hope(blocks)
    attempts = Attempts(*(np.concatenate(arrays) for arrays in zip(*blocks, strict=True)))
    last = np.flatnonzero(np.cumsum(attempts.accepted) == settings.sequences)[0] + 1
    attempts = Attempts(*(array[:last] for array in attempts))
    states = (block.states[block.accepted] for block in map(read_block, paths))
    write_raw(folder, attempts, states, settings.simulation, topology, seed=settings.seed, attributes=attributes)
    return summarise(attempts)


def summarise(attempts: Attempts) -> Summary:
    """Return the counts of accepted attempts and of rejected ones by reason."""
    rejected = Counter(attempts.reason[~attempts.accepted].tolist())
    hands = attempts.hands[attempts.accepted]
    single = float((hands == 1).mean()) if hands.size else 0.0
    return Summary(len(attempts.attempt), int(attempts.accepted.sum()), dict(rejected.most_common()), single)


def _check_hope(blocks: list[Attempts]) -> None:
    """Raise InputError if too many attempts in a row were rejected (see HOPELESS)."""
    accepted = np.concatenate([block.accepted for block in blocks])
    last = int(np.flatnonzero(accepted)[-1]) + 1 if accepted.any() else 0
    since = len(accepted) - last
    if since < max(HOPELESS, UNUSUAL * last / max(1, accepted.sum())):
        return
    reasons = Counter(np.concatenate([block.reason for block in blocks])[last:].tolist()).most_common()
    why = ", ".join(f"{name} {count}" for name, count in reasons)
    of = f"none of {since} attempted sequences" if last == 0 else f"none of the last {since} attempted sequences"
    raise InputError(
        f"params.yaml: simulate.limits accepted {of} ({why}); change simulate.limits, simulate.simulation or "
        "simulate.sampling"
    )


def make_block(number: int, settings: SimulateConfig, work: Path, topology: Topology) -> Path:
    """Run a block of attempts unless its file exists, and return the path; the file appears only when complete."""
    path = work / f"block_{settings.block}_{number:06d}.npz"
    if not path.exists():
        numbers = range(number * settings.block, (number + 1) * settings.block)
        attempts = attempt_sequences(numbers, settings, topology)
        unfinished = path.with_suffix(".part")
        with unfinished.open("wb") as file:
            np.savez(file, **attempts._asdict())  # type: ignore[arg-type]
        os.replace(unfinished, path)
    return path


def read_block(path: Path) -> Attempts:
    """The attempts of a block's file. Raises InputError when it is damaged."""
    try:
        with path.open("rb") as file, np.load(file) as arrays:
            return Attempts(**{name: arrays[name] for name in Attempts._fields})
    except Exception as error:  # of zipfile, zlib, NumPy
        raise damaged_piece(error, path) from error


def _finished_blocks(
    settings: SimulateConfig, work: Path, wanted: Callable[[], int], topology: Topology
) -> Iterator[Path]:
    """Yield the blocks' files in order; the blocks are made in parallel by all workers.

    On CUDA they are made in this process, since one block fills the device. No more blocks are started in advance than
    `wanted` returns.
    """
    workers = settings.workers or cores()
    number = 0
    if workers == 1 or settings.simulation.device != "cpu":
        while True:
            yield make_block(number, settings, work, topology)
            number += 1
    pool = make_pool(workers)
    try:
        jobs: dict[int, Future[Path]] = {}
        while True:
            for ahead in range(number, number + min(AHEAD * workers, wanted())):
                if ahead not in jobs:
                    jobs[ahead] = pool.submit(make_block, ahead, settings, work, topology)
            wait([jobs[number]], return_when=FIRST_COMPLETED)
            yield jobs.pop(number).result()
            number += 1
    finally:
        pool.shutdown(wait=True, cancel_futures=True)

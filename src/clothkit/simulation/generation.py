"""Recording sequences: blocks of attempts over worker processes, resumable, the same whatever the number of workers."""

import os
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from clothkit.errors import InputError
from clothkit.simulation.attempts import Attempts, attempt_sequences
from clothkit.simulation.processes import cores, make_pool
from clothkit.simulation.records import write_raw
from clothkit.simulation.settings import SimulateConfig

AHEAD = 2  # blocks in flight per worker
HOPELESS = 200  # attempts without an accepted one after which it ends


class Summary(NamedTuple):
    """How the recording went."""

    attempts: int
    accepted: int
    reasons: dict[str, int]
    """Rejected attempts by reason, most frequent first."""
    single_share: float
    """Of the accepted manipulations."""

    def __str__(self) -> str:
        """One sentence."""
        reasons = ", ".join(f"{name} {count}" for name, count in self.reasons.items()) or "none"
        return (
            f"{self.accepted} of {self.attempts} attempts accepted ({self.accepted / self.attempts:.1%}), "
            f"{self.single_share:.1%} of the manipulations single-handed; rejected: {reasons}"
        )


def generate(folder: Path, settings: SimulateConfig, *, work: Path, attributes: dict[str, Any]) -> Summary:
    """Record `settings.sequences` accepted sequences under `folder`, as raw parquet, and return how it went.

    Accepted sequences are taken in the order of their attempts' numbers, so workers and blocks change nothing.
    Finished blocks lie in `work`; an interrupted run goes on from them. Raises InputError when the limits accept
    nothing.
    """
    paths: list[Path] = []
    # Without their states, which would fill the memory: these are read again, block by block, as they are written.
    blocks: list[Attempts] = []
    accepted = 0
    with tqdm(total=settings.sequences, desc="simulate", unit="sequence", mininterval=1, smoothing=0.05) as bar:
        for path in _finished_blocks(settings, work):
            block = read_block(path)
            paths.append(path)
            blocks.append(block._replace(states=block.states[:, :0].copy()))
            accepted += int(block.accepted.sum())
            bar.update(min(accepted, settings.sequences) - bar.n)
            tried = sum(len(b.attempt) for b in blocks)
            bar.set_postfix({"yield": f"{accepted / tried:.0%}"}, refresh=False)
            if accepted >= settings.sequences:
                break
            if accepted == 0 and tried >= HOPELESS:
                raise InputError(f"params.yaml: simulate.limits accepted none of {tried} attempted sequences")
    attempts = Attempts(*(np.concatenate(arrays) for arrays in zip(*blocks, strict=True)))
    last = np.flatnonzero(np.cumsum(attempts.accepted) == settings.sequences)[0] + 1
    attempts = Attempts(*(array[:last] for array in attempts))
    states = (block.states[block.accepted] for block in map(read_block, paths))
    write_raw(folder, attempts, states, settings.simulation, seed=settings.seed, attributes=attributes)
    return summarise(attempts)


def summarise(attempts: Attempts) -> Summary:
    """How many attempts were accepted, and why the others were not."""
    rejected = Counter(attempts.reason[~attempts.accepted].tolist())
    hands = attempts.hands[attempts.accepted]
    single = float((hands == 1).mean()) if hands.size else 0.0
    return Summary(len(attempts.attempt), int(attempts.accepted.sum()), dict(rejected.most_common()), single)


def make_block(number: int, settings: SimulateConfig, work: Path) -> Path:
    """Attempt a block of sequences unless it is there already; return its file, which appears only when finished."""
    path = work / f"block_{settings.block}_{number:06d}.npz"
    if not path.exists():
        attempts = attempt_sequences(range(number * settings.block, (number + 1) * settings.block), settings)
        unfinished = path.with_suffix(".part")
        with unfinished.open("wb") as file:
            np.savez(file, **attempts._asdict())  # type: ignore[arg-type]
        os.replace(unfinished, path)
    return path


def read_block(path: Path) -> Attempts:
    """The attempts of a block's file."""
    with np.load(path) as arrays:
        return Attempts(**{name: arrays[name] for name in Attempts._fields})


def _finished_blocks(settings: SimulateConfig, work: Path) -> Iterator[Path]:
    """The blocks' files in order, made on all workers at once (on CUDA in this process: a block fills the device)."""
    workers = settings.workers or cores()
    number = 0
    if workers == 1 or settings.simulation.device != "cpu":
        while True:
            yield make_block(number, settings, work)
            number += 1
    pool = make_pool(workers)
    try:
        jobs: dict[int, Future[Path]] = {}
        while True:
            for ahead in range(number, number + AHEAD * workers):
                if ahead not in jobs:
                    jobs[ahead] = pool.submit(make_block, ahead, settings, work)
            wait([jobs[number]], return_when=FIRST_COMPLETED)
            yield jobs.pop(number).result()
            number += 1
    finally:
        pool.shutdown(wait=True, cancel_futures=True)

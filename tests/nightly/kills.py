"""The chain at smoke scale, killed many times at random: it must end with the bytes of an unbroken run.

    ./run python -m tests.nightly.kills [KILLS] [--seed 0] [--folder FOLDER] [--csv FOLDER] [--targets STAGE..]

Runs the chain unbroken, and then in another checkout, where `dvc repro` is killed with all its processes, KILLS times
in all (default: 50), and at last left alone. When the chain comes to its end between two kills, its outputs are
compared, and it begins again in a checkout without data, lock, cache and `.work`. Only what was killed while a stage
was running counts as a kill.

The time of each kill is drawn for the stage that runs first after the start: from when it has imported its code, as
the unbroken run tells, to twice as long as it works. So some kills come to the stages after it, and every stage comes
to its end at some time. With `--targets` only these stages run, and those that they need.

Every kill and every output that differs is printed. Exits with 1 if there are any, or if a run ends by itself with an
error. It takes long, so it is no test of the suite. Reports are left out: they tell how long stages took.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from ruamel.yaml import YAML

from benchmarks.tables import show
from tests.pipeline.test_smoke import Checkout

DVCS_OWN = {
    "dvc.lock' is invalid": "dvc.lock",
    "dvc.lock' validation failed": "dvc.lock",
    "Unable to read RWLock-file": ".dvc/tmp/rwlock",
}
"""Files that DVC does not replace as a whole, by what it says when a kill has cut one of them off. Without them, DVC
takes outputs from its cache."""


class Span(NamedTuple):
    """When a stage works, in seconds from its start."""

    imported: float
    ended: float


class Run:
    """A running `dvc repro`, and the stages that it has started."""

    def __init__(self, checkout: Checkout, targets: list[str]) -> None:
        self.process = checkout.start("dvc", "repro", *targets)
        self.said: list[str] = []
        self.stages: list[tuple[str, float]] = []
        """Name and time of start."""
        self.began = threading.Event()
        """Set when a stage has started, or the run has ended."""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout:
            for line in self.process.stdout:
                self.said.append(line)
                if line.startswith("Running stage '"):
                    self.stages.append((line.split("'")[1], time.monotonic()))
                    self.began.set()
        self.began.set()

    def ended(self, within: float | None = None) -> bool:
        """Whether it ends within so many seconds (None: it is awaited). `said` is then complete."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(within)
            self._reader.join()
        return self.process.returncode is not None

    def kill(self) -> None:
        """Kill all its processes."""
        if self.process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
        self.ended()

    def check(self) -> None:
        """Exit if it ended with an error."""
        if self.process.returncode:
            sys.exit(f"dvc repro ended with status {self.process.returncode}:\n{''.join(self.said)}")


def whole(checkout: Checkout, targets: list[str]) -> Run:
    """A run that nobody kills. Exits if it ends with an error."""
    run = Run(checkout, targets)
    try:
        run.ended()
    finally:
        run.kill()
    run.check()
    return run


def spans(checkout: Checkout, run: Run, end: float) -> dict[str, Span]:
    """When each stage of an unbroken run works, DVC's storing of its outputs included."""
    found = {}
    ends = [*(start for _, start in run.stages[1:]), end]
    for (name, start), after in zip(run.stages, ends, strict=True):
        timing = checkout.folder / f".work/timings/{name}.json"
        worked = json.loads(timing.read_text())["seconds"] if timing.exists() else after - start
        found[name] = Span(max(0.0, after - start - worked), after - start)
    return found


def outs(checkout: Checkout) -> dict[str, str]:
    """Return the hash of every out of the chain but reports, by path."""
    stages = YAML(typ="safe").load(checkout.folder / "dvc.lock")["stages"]
    found = {out["path"]: out["md5"] for stage in stages.values() for out in stage["outs"]}
    return {path: md5 for path, md5 in found.items() if not path.startswith("reports/")}


def new_checkout(folder: Path, old: Checkout | None = None) -> Checkout:
    """A checkout in which nothing has run, with the sources and compiled programs of an old one, which is deleted."""
    folder.mkdir(parents=True)
    made = Checkout(folder) if old is None else Checkout(folder, old.folder)
    if old is not None:
        compiled = old.folder / ".work/compiled"
        if compiled.exists():
            (folder / ".work").mkdir(exist_ok=True)
            compiled.rename(folder / ".work/compiled")
        shutil.rmtree(old.folder)
    return made


def mended(checkout: Checkout, said: list[str]) -> str | None:
    """Delete the file of DVC's own that it says is damaged, and return its name."""
    for words, name in DVCS_OWN.items():
        if words in "".join(said) and (checkout.folder / name).exists():
            (checkout.folder / name).unlink()
            return name
    return None


class Broken:
    """The chain that is killed, again and again."""

    def __init__(self, checkout: Checkout, targets: list[str], wanted: dict[str, str], usual: dict[str, Span]) -> None:
        self.checkout, self.targets, self.wanted, self.usual = checkout, targets, wanted, usual
        self.rounds = 0
        """Chains that have come to their end."""
        self.differing: set[str] = set()
        """Paths of outputs that were not those of the unbroken run."""
        self.kills: Counter[str] = Counter()
        """By the stage that was running."""
        self.mended: Counter[str] = Counter()
        """Files of DVC's own that kills had damaged."""
        self.just_mended = False

    def start(self, rng: random.Random) -> None:
        """Run, and kill it if it has not ended after a time that is drawn."""
        run = Run(self.checkout, self.targets)
        try:
            run.began.wait()
            if not run.stages:
                run.ended()
            else:
                name, begun = run.stages[0]
                span = self.usual.get(name, Span(0.0, 10.0))
                # Longer after each kill: the machine may be busier than it was, and the chain has to come to its end.
                after = span.imported + rng.uniform(0, 2 + self.kills[name]) * (span.ended - span.imported)
                if not run.ended(max(0.0, begun + after - time.monotonic())):
                    run.kill()
                    self.kills[run.stages[-1][0]] += 1
                    self.just_mended = False
                    print(f"kill {self.kills.total()}: {run.stages[-1][0]}, {after:.1f} s after {name}", flush=True)
                    return
        finally:
            run.kill()
        if self.came_to_its_end(run):
            self.checkout = new_checkout(self.checkout.folder.with_name(f"broken_{self.rounds}"), self.checkout)

    def end(self) -> None:
        """Leave the chain alone until it has come to its end."""
        done = False
        while not done:
            run = Run(self.checkout, self.targets)
            try:
                run.ended()
            finally:
                run.kill()
            done = self.came_to_its_end(run)

    def came_to_its_end(self, run: Run) -> bool:
        """Compare the outputs if a run has ended well; if it tells of damage to a file of DVC's own, delete that file.

        Exits if a run ended with another error, and if it does not help to delete the file.
        """
        name = mended(self.checkout, run.said) if run.process.returncode and not self.just_mended else None
        self.just_mended = name is not None
        if name is not None:
            self.mended[name] += 1
            print(f"{name} was damaged, and is deleted", flush=True)
            return False
        run.check()
        self.compare()
        return True

    def compare(self) -> None:
        """Compare the outputs of a chain that has come to its end with those of the unbroken run."""
        self.rounds += 1
        found = outs(self.checkout)
        differing = [path for path in self.wanted.keys() | found.keys() if self.wanted.get(path) != found.get(path)]
        self.differing.update(differing)
        print(f"round {self.rounds}: {len(self.wanted)} outputs, {len(differing)} differ {differing or ''}", flush=True)


def main() -> None:
    """Run both chains, and exit with 1 if an output differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kills", type=int, nargs="?", default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="an empty folder for the checkouts (default: a temporary one)")
    parser.add_argument("--csv", type=Path, help="a folder for a row of figures, kills.csv")
    parser.add_argument("--targets", nargs="+", default=[], help="stages (default: all)")
    asked = parser.parse_args()
    rng = random.Random(asked.seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = asked.folder or Path(temporary)
        started = time.monotonic()
        # Both at once, so that they have the same sources even if someone edits these meanwhile.
        unbroken, first = new_checkout(folder / "unbroken"), new_checkout(folder / "broken_0")
        run = whole(unbroken, asked.targets)
        alone = time.monotonic() - started
        print(f"unbroken: {alone:.0f} s", flush=True)
        broken = Broken(first, asked.targets, outs(unbroken), spans(unbroken, run, time.monotonic()))
        while broken.kills.total() < asked.kills:
            broken.start(rng)
        broken.end()
        row = {
            "kills": broken.kills.total(),
            "stages killed": len(broken.kills),
            "rounds": broken.rounds,
            "outputs": len(broken.wanted),
            "differing": len(broken.differing),
            "files of DVC mended": broken.mended.total(),
            "minutes": round((time.monotonic() - started) / 60, 1),
            "minutes unbroken": round(alone / 60, 1),
            "cores": len(os.sched_getaffinity(0)),
            "seed": asked.seed,
        }
        show("Kills", [row], csv=asked.csv)
        same = f"{len(broken.differing)} outputs differ" if broken.differing else "all bytes are equal"
        print(f"{broken.kills.total()} kills in {broken.rounds} rounds: {same} {' '.join(sorted(broken.differing))}")
        sys.exit(1 if broken.differing else 0)


if __name__ == "__main__":
    main()

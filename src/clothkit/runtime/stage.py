"""Shared parts of stage scripts: params, a work directory that survives a kill, timing, one-sentence errors."""

import contextlib
import fcntl
import hashlib
import json
import os
import platform
import resource
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import clothkit
from clothkit.params import Params, load_params
from clothkit.runtime.cache import ensure_jax_cache
from clothkit.runtime.errors import InputError, untold_error
from clothkit.runtime.publish import alone, leftovers, publish, recover

WORK = Path(".work")
PUBLISHING = WORK / "publishing.lock"
PLACES = (Path("data"), Path("reports"))
"""Folders under which stages publish their outputs."""
LEFT_OUT = b"left out"
"""How the file begins that stands in the place of an output that a scale does without."""


class Stage:
    """One run of a stage. `params` is the stage's section of params.yaml (None if it has none), `shared` all of it."""

    def __init__(self, name: str, variant: str | None) -> None:
        self.name = f"{name}@{variant}" if variant else name
        if leftovers(PLACES):
            with alone(PUBLISHING):
                # Look again under the lock: the files may have belonged to another run that was publishing.
                for target in leftovers(PLACES):
                    recover(target)
        self.shared: Params = load_params(Path("params.yaml"))
        self.params: Any = getattr(self.shared.stages, name, None)
        self._work: list[tuple[Path, Any]] = []
        self.costs: dict[str, Any] = {}
        """Further entries for the record of the run's cost, JSON types only."""

    @property
    def attributes(self) -> dict[str, Any]:
        """Provenance that is stored in artifacts: stage, scale and params that decide outcomes, JSON types only."""
        return {"stage": self.name, "scale": self.shared.scale, "params": self._section()}

    def _section(self) -> dict[str, Any]:
        return {} if self.params is None else self.shared.decisive_section(self.name.split("@")[0])

    def work(self, *, inputs: list[Path]) -> Path:
        """Create and lock a directory for partial results: `.work/<stage>/<hash of params, inputs and code>/`.

        A killed run leaves it; the next run with the same params, inputs and code gets the same directory and resumes.
        Params that change no outcome do not count: work goes on from one executor to another.
        Raises InputError when an input is missing or another process holds the lock.
        """
        digest = hashlib.sha256(json.dumps(self.attributes, sort_keys=True).encode())
        for path in [*_own_code(), *inputs]:
            _hash_into(digest, path)
        directory = WORK / self.name / digest.hexdigest()[:16]
        directory.parent.mkdir(parents=True, exist_ok=True)
        lock = _locked(directory.parent / f"{directory.name}.lock")
        if lock is None:
            raise InputError(f"{directory}: another run of stage {self.name} is at work here; wait for it")
        directory.mkdir(exist_ok=True)
        self._work.append((directory, lock))
        return directory

    @staticmethod
    def pieces(work: Path, *settings: Any) -> Path:
        """A folder in a work directory whose name is a hash of settings of other stages, by their reprs.

        Pieces that were made with other weights or another simulator are thus not reused. Of the stage `simulate`, hand
        over `SimulateConfig.decisive`.
        """
        return work / hashlib.sha256(repr(settings).encode()).hexdigest()[:16]

    def publish(self, source: Path, target: Path | str) -> None:
        """Move a finished file or directory to its place under data/ or reports/, replacing what was there as a whole.

        A kill leaves the old output or the new one. If a stage has several outputs, some may then be new and others
        old. DVC records a stage only once it has ended, and so runs it again; if you run stages by hand, do the same.
        The next run resumes from its partial results and publishes all outputs again. (DVC deletes most outputs before
        it runs a stage; `dvc checkout` restores them from its cache.) Raises InputError when the output can't be
        written; the old one and `source` are then unchanged.
        """
        with alone(PUBLISHING):
            publish(source, Path(target))

    def leave_out(self, *targets: Path | str) -> None:
        """Publish a note in the place of outputs that this scale does without (see `is_left_out`)."""
        work = self.work(inputs=[])
        for target in targets:
            note = work / "note"
            note.write_bytes(LEFT_OUT + f" of scale {self.shared.scale}\n".encode())
            self.publish(note, target)

    def close(self, started: float) -> None:
        """Write the run's cost to `.work/timings/` and delete its work directories."""
        seconds = time.monotonic() - started
        usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        cost = {
            "stage": self.name,
            "seconds": round(seconds, 1),
            "cpu_seconds": round(sum(u.ru_utime + u.ru_stime for u in usage), 1),
            "peak_memory_mib": round(max(u.ru_maxrss for u in usage) / 1024),
            "machine": f"{os.cpu_count()} x {platform.machine()} {platform.system()}",
            **self.costs,
        }
        path = WORK / "timings" / f"{self.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_text(json.dumps(cost, indent=1))
        os.replace(part, path)
        for directory, lock in self._work:
            shutil.rmtree(directory, ignore_errors=True)
            Path(lock.name).unlink(missing_ok=True)

    def release(self) -> None:
        """Release the locks of the work directories."""
        for _, lock in self._work:
            lock.close()


def is_left_out(path: Path) -> bool:
    """Return whether a note stands in the place of an output, since its stage is left out at this scale."""
    try:
        with path.open("rb") as file:
            return file.read(len(LEFT_OUT)) == LEFT_OUT
    except OSError:
        return False


@contextlib.contextmanager
def stage(name: str, variant: str | None = None) -> Iterator[Stage]:
    """Run a stage script's body. Bad input ends it with one sentence and exit status 1; partial results stay.

    Refuses to run if the imported clothkit is not `src/clothkit` of the current directory: an experiment in a copy of
    the checkout (`dvc exp run --temp`, `--queue`) would record results of code that is not in its snapshot. dvc.yaml
    sets PYTHONPATH, so that a copy imports its own code.
    """
    started = time.monotonic()
    run = None
    try:
        expected = Path("src/clothkit").resolve()
        if Path(clothkit.__file__).resolve().parent != expected:
            raise InputError(
                f"{clothkit.__file__}: expected the clothkit of the current directory, {expected}; "
                "run the stage with dvc repro, or from a checkout with PYTHONPATH=src"
            )
        ensure_jax_cache(WORK / "compiled")
        run = Stage(name, variant)
        yield run
        run.close(started)
    except InputError as error:
        sys.exit(f"{name}: {error}")
    except Exception as error:
        told = untold_error(error)
        if told is None:
            raise
        sys.exit(f"{name}: {told}")
    finally:
        if run is not None:
            run.release()


def _locked(path: Path) -> TextIO | None:
    """A lock file, opened and locked; None if another process holds it.

    A run deletes its lock file when it has ended. Another run that had opened it before then locks a file that nobody
    else can find, and a third run would make a new one: so what is locked must be what is at `path`.
    """
    while True:
        file = path.open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        except BlockingIOError:
            file.close()
            return None
        except FileNotFoundError:
            pass
        file.close()


def _own_code() -> list[Path]:
    """The files of the modules in use: the stage script and every clothkit module that it has imported."""
    names = [n for n in sys.modules if n == "__main__" or n.split(".")[0] == "clothkit"]
    files = {getattr(sys.modules[n], "__file__", None) for n in names} - {None}
    return sorted(Path(str(f)) for f in files)


def _hash_into(digest: Any, path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path}: not found; run the stage that writes it (dvc repro)")
    for file in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
        digest.update(file.name.encode())
        digest.update(file.read_bytes())

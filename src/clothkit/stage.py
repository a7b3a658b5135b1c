"""What every stage script shares: its params, a work directory that survives a kill, timing, one-sentence errors."""

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
from typing import Any

import jax

import clothkit
from clothkit.errors import InputError
from clothkit.params import Params, load_params

WORK = Path(".work")

COMPILED_BYTES = 2**30
"""What compiled programs may take, kept so that a stage that goes on, and its variants, need not compile again."""


class Stage:
    """One run of a stage. `params` is the stage's section of params.yaml, `shared` the whole of it."""

    def __init__(self, name: str, variant: str | None) -> None:
        self.name = f"{name}@{variant}" if variant else name
        self.shared: Params = load_params(Path("params.yaml"))
        self.params: Any = getattr(self.shared.stages, name)
        self._work: list[tuple[Path, Any]] = []
        self.costs: dict[str, Any] = {}
        """What else the note of the run's cost says, JSON types only."""

    @property
    def attributes(self) -> dict[str, Any]:
        """What an artifact says of how it was made: stage, scale and params, JSON types only."""
        return {"stage": self.name, "scale": self.shared.scale, "params": self.shared.section(self.name.split("@")[0])}

    def work(self, *, inputs: list[Path]) -> Path:
        """A directory for resumable pieces, `.work/<stage>/<hash of params, inputs and code>/`, locked for this run.

        A killed run leaves it; the next run with the same params, inputs and code finds it again and goes on.
        Raises InputError when another process works there.
        """
        digest = hashlib.sha256(json.dumps(self.attributes, sort_keys=True).encode())
        for path in [*_own_code(), *inputs]:
            _hash_into(digest, path)
        directory = WORK / self.name / digest.hexdigest()[:16]
        directory.mkdir(parents=True, exist_ok=True)
        lock = (directory.parent / f"{directory.name}.lock").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{directory}: another run of stage {self.name} is at work here; wait for it") from error
        self._work.append((directory, lock))
        return directory

    def publish(self, source: Path, target: Path | str) -> None:
        """Move a finished file or directory to its place under data/ or reports/, replacing what was there."""
        target = Path(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            shutil.rmtree(target)
        os.replace(source, target)

    def close(self, started: float) -> None:
        """Note the run's cost and drop its work directories."""
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
        path.write_text(json.dumps(cost, indent=1))
        for directory, lock in self._work:
            shutil.rmtree(directory, ignore_errors=True)
            lock.close()
            Path(lock.name).unlink(missing_ok=True)


@contextlib.contextmanager
def stage(name: str, variant: str | None = None) -> Iterator[Stage]:
    """Run a stage script's body: bad input ends it with one sentence and exit status 1, pieces of work stay.

    Refuses to run another clothkit than `src/clothkit` in the current directory: an experiment in a copy of the
    checkout (`dvc exp run --temp`, `--queue`) would record results of code that is not in its snapshot. dvc.yaml sets
    PYTHONPATH for that.
    """
    started = time.monotonic()
    try:
        expected = Path("src/clothkit").resolve()
        if Path(clothkit.__file__).resolve().parent != expected:
            raise InputError(
                f"{clothkit.__file__}: expected the clothkit of the current directory, {expected}; "
                "run the stage with dvc repro, or from a checkout with PYTHONPATH=src"
            )
        if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
            jax.config.update("jax_compilation_cache_dir", str(WORK / "compiled"))
            jax.config.update("jax_compilation_cache_max_size", COMPILED_BYTES)
        run = Stage(name, variant)
        yield run
    except InputError as error:
        sys.exit(f"{name}: {error}")
    run.close(started)


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

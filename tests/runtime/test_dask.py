"""Pieces on a Dask cluster: a scheduler that is lost, workers with other code, and what each of them tells."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tqdm import tqdm

from clothkit.runtime import remote
from clothkit.runtime.dask_pool import open_dask
from clothkit.runtime.errors import InputError
from clothkit.runtime.remote import fingerprint
from clothkit.runtime.resumable import Piece, resumable_map
from tests.documents import blocks
from tests.pool import SerialPool
from tests.runtime.test_resumable import PAIRS, Pair
from tests.tiny import ROOT

distributed = pytest.importorskip("distributed")

# Closed clusters leave sockets and tasks of their event loops to the garbage collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def pair(number: int, folder: str, wait: float = 0.0) -> Pair:
    """A piece, which leaves a file where it was computed."""
    time.sleep(wait)
    with open(f"{folder}/computed", "a") as file:
        file.write(f"{number}\n")
    return Pair(np.arange(number), np.array([str(number)]))


def mapped(folder: Path, compute: Any, pool: Any, count: int = 6) -> Iterator[Piece[Pair]]:
    bar = tqdm(total=100, disable=True)
    sizes: dict[str, Any] = {"bar": bar, "count": lambda value: len(value.numbers), "ahead": lambda: 3}
    return resumable_map(compute, range(count), folder=folder, name="pair", storage=PAIRS, pool=pool, **sizes)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("pair_*.npz"))}


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def cluster(port: int) -> Iterator[Any]:
    """A scheduler at a port and two workers, all in this process."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        scheduler_port=port,
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as made:
        yield made


@contextmanager
def worker_of(source: Path, address: str, folder: Path) -> Iterator[None]:
    """A worker process that runs the clothkit at `source`."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(source), *filter(None, sys.path)])}
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny", "--no-dashboard"]
    with (folder / "worker.log").open("w") as log:
        process = subprocess.Popen(
            [*command, "--nthreads", "1", "--local-directory", str(folder)],
            cwd=folder,
            env=environment,
            stdout=log,
            stderr=log,
        )
        try:
            yield
        finally:
            process.kill()
            process.wait()


def test_a_scheduler_that_is_lost_and_started_again(tmp_path: Path) -> None:
    """One sentence; what was stored is not computed again, and the pieces are those of a run on one machine."""
    alone, lost, port = tmp_path / "alone", tmp_path / "lost", free_port()
    compute = partial(pair, folder=str(tmp_path), wait=0.05)
    expected = list(mapped(alone, compute, SerialPool()))
    address = f"tcp://127.0.0.1:{port}"
    (tmp_path / "computed").unlink()
    with cluster(port) as made, open_dask(address, workers=1) as pool:
        assert pool.width == 2
        pieces = mapped(lost, compute, pool)
        for _ in islice(pieces, 3):
            pass
        made.scheduler.stop()
        made.close()
        with pytest.raises(InputError, match=r"the Dask scheduler at .* was lost while it computed; .* run again"):
            list(pieces)
    stored = contents(lost)
    assert len(stored) >= 3
    assert not list(lost.glob("*.part"))
    (tmp_path / "computed").unlink()
    with cluster(port), open_dask(address, workers=1) as pool:
        found = list(mapped(lost, compute, pool))
    again = {int(line) for line in (tmp_path / "computed").read_text().split()}
    assert len(again) == 6 - len(stored)
    assert contents(lost) == contents(alone)
    assert [piece.path.name for piece in found] == [piece.path.name for piece in expected]


def test_a_worker_with_other_code_is_refused(tmp_path: Path) -> None:
    """Also one that has loaded its code before it was changed; a worker with this code computes."""
    other = tmp_path / "other"
    shutil.copytree(ROOT / "src/clothkit", other / "clothkit", ignore=shutil.ignore_patterns("__pycache__"))
    assert fingerprint(other / "clothkit") == remote.LOADED
    changed = other / "clothkit/simulation/quality.py"
    changed.write_text(changed.read_text() + "\n# Changed.\n")
    told = fingerprint(other / "clothkit")
    assert told != remote.LOADED
    with distributed.LocalCluster(
        n_workers=0, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as made:
        address = made.scheduler_address
        compute = partial(pair, folder=str(tmp_path))
        with (
            worker_of(other, address, tmp_path),
            open_dask(address, workers=1) as pool,
            pytest.raises(
                InputError, match=f"other code: its fingerprint is {told}, expected {remote.LOADED}"
            ) as error,
        ):
            list(mapped(tmp_path / "pieces", compute, pool))
        assert len(str(error.value).splitlines()) == 1
        assert not (tmp_path / "computed").exists()
        with worker_of(ROOT / "src", address, tmp_path), open_dask(address, workers=1) as pool:
            assert pool.submit(pow, 2, 5).result(300) == 32


def given_up(number: int) -> Pair:
    """What a cluster answers for a piece that ended its workers."""
    raise distributed.scheduler.KilledWorker("piece", SimpleNamespace(address="tcp://10.0.0.7:39001"), 2)


def test_a_piece_that_ended_its_workers_is_told_in_one_sentence(tmp_path: Path) -> None:
    with cluster(free_port()) as made, open_dask(made.scheduler_address, workers=1) as pool:
        sentence = r"a piece of work ended 3 Dask workers one after another, the last at tcp://10\.0\.0\.7:39001; read"
        with pytest.raises(InputError, match=sentence):
            list(mapped(tmp_path, given_up, pool))


def test_an_error_of_a_piece_is_its_own(tmp_path: Path) -> None:
    with cluster(free_port()) as made, open_dask(made.scheduler_address, workers=1) as pool:
        with pytest.raises(ZeroDivisionError):
            pool.submit(divmod, 1, 0).result(300)
        # A function of a script, which workers could not import.
        assert pool.submit(lambda number: number + 1, 2).result(300) == 3


def test_no_scheduler_is_told_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clothkit.runtime.dask_pool._SECONDS", 0.5)
    address = f"tcp://127.0.0.1:{free_port()}"
    with (
        pytest.raises(InputError, match=f"no Dask scheduler answers at {address}: is it running"),
        open_dask(address, workers=1),
    ):
        pass


def test_the_job_script_of_the_page_starts_workers_of_this_checkout(tmp_path: Path) -> None:
    """SLURM itself is not here: only what would be submitted is looked at."""
    pytest.importorskip("dask_jobqueue")
    (block,) = (b for b in blocks(ROOT / "docs/gpu-and-cluster.md") if "SLURMCluster" in b.code)
    names: dict[str, Any] = {}
    exec(block.code, names)
    with names["slurm_cluster"](tmp_path) as made:
        script = made.job_script()
    assert "#SBATCH -p normal" in script
    assert f"export PYTHONPATH={tmp_path}/src" in script
    assert f"{tmp_path}/.venv/bin/python -m distributed.cli.dask_worker tcp://" in script
    assert "--nthreads 1" in script


def test_the_fingerprint_is_taken_before_sources_can_be_edited(tmp_path: Path) -> None:
    """Minutes may pass between the import of the simulator and the first piece of a plan."""
    shutil.copytree(ROOT / "src/clothkit", tmp_path / "clothkit", ignore=shutil.ignore_patterns("__pycache__"))
    before = fingerprint(tmp_path / "clothkit")
    program = (
        "import sys; from clothkit.runtime import dask_pool\n"
        "open('clothkit/simulation/quality.py', 'a').write('# Edited.')\n"
        "from clothkit.runtime import remote; print(remote.LOADED, 'distributed' in sys.modules)"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert ended.stdout.split() == [before, "False"]
    assert fingerprint(tmp_path / "clothkit") != before


def test_the_fingerprint_is_of_every_source(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "a.py").write_text("a = 1\n")
    (tmp_path / "inner/b.py").write_text("b = 1\n")
    first = fingerprint(tmp_path)
    assert fingerprint(tmp_path) == first
    (tmp_path / "notes.txt").write_text("no code\n")
    assert fingerprint(tmp_path) == first
    (tmp_path / "inner/b.py").rename(tmp_path / "b.py")
    moved = fingerprint(tmp_path)
    (tmp_path / "b.py").write_text("b = 2\n")
    assert len({first, moved, fingerprint(tmp_path)}) == 3

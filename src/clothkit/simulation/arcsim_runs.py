"""The table of ARCSim runs, `runs.csv`, which assigns a run and a frame to each state of each sequence."""

import csv
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

from clothkit.runtime.errors import InputError, system_error

TABLE = "runs.csv"
COLUMNS = ("sequence", "state", "folder", "frame")
LONGEST = 3  # manipulations in a sequence


class Run(NamedTuple):
    """A row of the table: a state and the run and frame that hold it."""

    sequence: int
    state: int
    folder: Path
    """Folder of the run that ends in this state; for state 0, of the run that starts from it."""
    frame: int

    @property
    def path(self) -> Path:
        """The file that holds the state."""
        return frame_path(self.folder, self.frame)

    @property
    def start(self) -> Path:
        """The file of the run's first mesh, to whose nodes the scene's handles refer."""
        return frame_path(self.folder, 0)

    @property
    def scene(self) -> Path:
        """The file of the run's scene."""
        return self.folder / "conf.json"


Sequence = tuple[Run, ...]
"""The runs of states 0..n, with n from 1 to 3."""


def frame_path(folder: Path, frame: int, cloth: int = 0) -> Path:
    """Return the path of a frame's file, FFFF_CC.obj."""
    return folder / f"{frame:04d}_{cloth:02d}.obj"


def read_runs(folder: str, most: int) -> list[Sequence]:
    """Return the first `most` sequences of `folder`/runs.csv, ordered by number, after checking that their files exist.

    Raises InputError that names the line of a row that can't be read, or the sequence whose states or files are
    missing.
    """
    if not folder:
        raise InputError("params.yaml: simulate.runs is empty; source arcsim expects the folder that holds runs.csv")
    path = Path(folder) / TABLE
    rows: dict[int, dict[int, Run]] = defaultdict(dict)
    for line, run in _rows(path):
        if run.state in rows[run.sequence]:
            raise InputError(f"{path}: line {line}: state {run.state} of sequence {run.sequence} is there already")
        rows[run.sequence][run.state] = run
    if not rows:
        raise InputError(f"{path}: holds no rows below its header, expected a row per state")
    sequences = []
    for number, states in sorted(rows.items())[:most]:
        last = max(states)
        if not 1 <= last <= LONGEST:
            raise InputError(f"{path}: sequence {number}: its last state is {last}, expected 1 to {LONGEST}")
        missing = [state for state in range(last) if state not in states]
        if missing:
            raise InputError(f"{path}: sequence {number}: state {missing[0]} is missing, expected all of 0..{last}")
        sequences.append(tuple(states[state] for state in range(last + 1)))
        _check_files(path, sequences[-1])
    return sequences


def files(sequences: list[Sequence]) -> list[Path]:
    """Return the paths of all files that the sequences are read from, sorted and without duplicates."""
    needed = [run.path for sequence in sequences for run in sequence]
    needed += [path for sequence in sequences for run in sequence[1:] for path in (run.start, run.scene)]
    return sorted(set(needed))


def _rows(path: Path) -> list[tuple[int, Run]]:
    try:
        # utf-8-sig, because spreadsheets write a byte order mark before the header.
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            header = [name.strip() for name in reader.fieldnames or ()]
            reader.fieldnames = header
            missing = [name for name in COLUMNS if name not in header]
            if missing:
                raise InputError(f"{path}: has no column {missing[0]!r}, expected {','.join(COLUMNS)}")
            return [(reader.line_num, _row(path, reader.line_num, fields)) for fields in reader]
    except OSError as error:
        raise system_error(error, path, expected=f"a table with the columns {','.join(COLUMNS)}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: can't be read as CSV ({error})") from error


def _row(path: Path, line: int, fields: dict[str, str]) -> Run:
    numbers = {}
    for name in ("sequence", "state", "frame"):
        text = (fields[name] or "").strip()
        if not (text.isascii() and text.isdigit()):
            raise InputError(f"{path}: line {line}: {name} is {text!r}, expected a whole number from 0")
        numbers[name] = int(text)
    folder = (fields["folder"] or "").strip()
    if not folder:
        raise InputError(f"{path}: line {line}: folder is empty, expected a run's folder beside {TABLE}")
    return Run(numbers["sequence"], numbers["state"], path.parent / folder, numbers["frame"])


def _check_files(table: Path, sequence: Sequence) -> None:
    for run in sequence:
        where = f"{table}: sequence {run.sequence}, state {run.state}"
        if not run.folder.is_dir():
            raise InputError(f"{where}: the folder {run.folder} is not there")
        needed = {run.path: f"frame {run.frame} of cloth 0"}
        if run.state:
            needed |= {run.start: "the frame that the run starts with", run.scene: "the run's scene"}
        for path, what in needed.items():
            if not path.is_file():
                raise InputError(f"{where}: {path} is not there, expected {what}")
        second = frame_path(run.folder, run.frame, cloth=1)
        if second.exists():
            raise InputError(f"{where}: {second} is a second cloth, expected one cloth, numbered 0")

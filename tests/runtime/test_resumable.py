"""The resumable map: kills at every file event, pieces computed in a pool and ahead, damaged pieces, the bar."""

import io
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tqdm import tqdm

from clothkit.runtime.errors import InputError
from clothkit.runtime.resumable import Piece, array_storage, load_piece, resumable_map
from tests.pool import SerialPool
from tests.runtime.test_publish import ROOT, run_program


class Pair(NamedTuple):
    numbers: np.ndarray
    names: np.ndarray


PAIRS = array_storage(Pair)


def pair(number: int, asked: list[int] | None = None) -> Pair:
    if asked is not None:
        asked.append(number)
    return Pair(np.arange(number, dtype=np.int8), np.array(["", "a" * number]))


def mapped(
    folder: Path, keys: Iterator[int] | range, compute: Callable[[int], Pair] = pair, total: int = 100, **more: Any
) -> Iterator[Piece[Pair]]:
    bar = tqdm(total=total, disable=True)
    sizes = {"bar": bar, "count": lambda value: len(value.numbers)}
    return resumable_map(compute, keys, folder=folder, name="pair", storage=PAIRS, **sizes, **more)


@pytest.mark.parametrize("form", ["file", "folder"])
def test_a_kill_at_any_file_event_costs_no_stored_piece(tmp_path: Path, form: str) -> None:
    ended = run_program(sys.executable, ROOT / "tests/killed_pieces.py", tmp_path / "pieces", form)
    assert ended.returncode == 0, ended.stderr
    assert int(ended.stdout) > 8


@given(stop=st.integers(0, 6), workers=st.integers(0, 3), ahead=st.integers(-1, 9))
def test_a_run_that_stops_anywhere_goes_on_to_the_same_pieces(
    tmp_path_factory: pytest.TempPathFactory, stop: int, workers: int, ahead: int
) -> None:
    folder = tmp_path_factory.mktemp("pieces")
    asked: list[int] = []
    compute = partial(pair, asked=asked)
    for value in islice(mapped(folder, range(6), compute), stop):
        assert isinstance(value.value, Pair)
    assert asked == list(range(stop))
    if workers:
        with ThreadPoolExecutor(workers) as pool:
            found = list(mapped(folder, range(6), compute, pool=pool, ahead=lambda: ahead))
    else:
        found = list(mapped(folder, range(6), compute))
    assert sorted(asked) == list(range(6))
    assert [piece.path.name for piece in found] == [f"pair_{number:06d}.npz" for number in range(6)]
    for number, piece in enumerate(found):
        for array, expected in zip(piece.value, pair(number), strict=True):
            np.testing.assert_array_equal(array, expected)
            assert array.dtype == expected.dtype


def test_no_more_pieces_are_started_than_asked_for(tmp_path: Path) -> None:
    asked: list[int] = []
    wanted = 3
    pieces = mapped(tmp_path, count(), partial(pair, asked=asked), pool=SerialPool(), ahead=lambda: wanted)
    next(pieces)
    assert asked == [0, 1, 2]
    next(pieces)
    assert asked == [0, 1, 2, 3]
    wanted = 1
    next(pieces)
    next(pieces)
    assert asked == [0, 1, 2, 3]
    next(pieces)
    assert asked == [0, 1, 2, 3, 4]


def test_the_bar_counts_pieces_up_to_its_total(tmp_path: Path) -> None:
    with tqdm(total=9, disable=False, file=io.StringIO()) as bar:
        pieces = resumable_map(
            pair, range(9), folder=tmp_path, name="pair", storage=PAIRS, bar=bar, count=lambda value: len(value.numbers)
        )
        # 0 + 1 + 2 + 3, then 4, of which 3 are left.
        assert [bar.n for _ in islice(pieces, 6)] == [0, 1, 3, 6, 9, 9]


@pytest.mark.parametrize("left", [0, 1, 100, -200])
def test_a_damaged_piece_is_told_in_one_sentence(tmp_path: Path, left: int) -> None:
    path = list(mapped(tmp_path, range(3)))[1].path
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(
        InputError, match=r"pair_000001\.npz: what an earlier run left is damaged \(.*; delete this file"
    ):
        list(mapped(tmp_path, range(3)))
    path.unlink()
    asked: list[int] = []
    list(mapped(tmp_path, range(3), partial(pair, asked=asked)))
    assert asked == [1]


def test_a_piece_of_other_arrays_is_damaged(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", numbers=np.arange(3))
    with pytest.raises(InputError, match=r"other\.npz: what an earlier run left is damaged"):
        load_piece(tmp_path / "other.npz", PAIRS)

"""Schemas of parquet tables, against which a table is checked whenever it is read.

In addition to the types of columns, which pyarrow's schemas have, these declare ranges, allowed texts, keys, rules
between columns, and which rows must exist.
"""

import dataclasses
import functools
import json
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from clothkit.runtime.errors import InputError, system_error

_KINDS: dict[str, Callable[[pa.DataType], bool]] = {
    "whole numbers": pa.types.is_integer,
    "numbers": lambda kind: pa.types.is_floating(kind) or pa.types.is_integer(kind),
    "true or false": pa.types.is_boolean,
    "text": lambda kind: pa.types.is_string(kind) or pa.types.is_large_string(kind),
}
_LIST = "lists of "
_NUMBERED = re.compile("(.+)_(0|[1-9][0-9]*)")


@dataclasses.dataclass(frozen=True)
class Column:
    """The schema of a column."""

    kind: str
    """A key of _KINDS, or `lists of` and such a key."""
    least: int | float = -np.inf
    most: int | float = np.inf
    among: tuple[str, ...] = ()
    """The allowed texts; empty if all are allowed."""
    missing: bool = False
    """Whether values, or items of lists, may be null or NaN."""
    infinite: bool = False
    """Whether numbers may be infinite."""
    optional: bool = False
    """Whether the whole column may be missing."""

    @property
    def item(self) -> str:
        """The kind of a value, or of the items if values are lists."""
        return self.kind.removeprefix(_LIST)

    @property
    def expected(self) -> str:
        """The expected values in words, for error messages."""
        low, high = np.isfinite(self.least), np.isfinite(self.most)
        limits = f" {self.least:g} to {self.most:g}" if low and high else f" from {self.least:g} on" if low else ""
        names = f" ({', '.join(self.among)})" if self.among else ""
        return f"{self.kind}{limits}{names}{' or nothing' if self.missing else ''}"


class Rule(NamedTuple):
    """A condition that every row must satisfy."""

    columns: tuple[str, ...]
    holds: Callable[[pd.DataFrame], Any]
    """Takes a frame of these columns, in this order; returns a truth value per row."""
    expected: str


class Complete(NamedTuple):
    """A condition on the number of rows in each group of rows with equal values in the columns `by`.

    It must equal the largest value of `rows` in the group. `rows` takes the whole frame, needs `columns`, and returns a
    number per row.
    """

    by: tuple[str, ...]
    columns: tuple[str, ...]
    rows: Callable[[pd.DataFrame], pd.Series]
    expected: str


@dataclasses.dataclass(frozen=True)
class Table:
    """The schema of a table."""

    columns: Mapping[str, Column]
    keys: tuple[str, ...] = ()
    """No two rows have the same values in all of these."""
    rules: tuple[Rule, ...] = ()
    complete: tuple[Complete, ...] = ()
    numbered: Mapping[str, Column] = dataclasses.field(default_factory=dict)
    """Optional columns of which there may be any number: `name` declares name_0, name_1, .."""
    may_be_empty: bool = False

    def of_file(self, names: Collection[str]) -> "Table":
        """The schema for a file with columns of these names: each numbered one among them is declared by itself."""
        stems = {name: match[1] for name in names if (match := _NUMBERED.fullmatch(name))}
        found = {name: self.numbered[stem] for name, stem in stems.items() if stem in self.numbered}
        return dataclasses.replace(self, columns={**self.columns, **found})


def read(
    path: Path, table: Table, columns: Sequence[str] = (), *, sequences: Collection[int] | None = None
) -> pd.DataFrame:
    """Read the rows of a parquet file, or those of some `sequences`, and check them against the schema.

    With `columns`, only these are read, and optional ones may be absent. Otherwise all columns of the file are read;
    undeclared ones are not checked. Raises InputError, which names the file, the column and what was expected.
    """
    rows = None if sequences is None else [("sequence", "in", sorted(sequences))]
    return _read(
        path, table, columns, lambda names: pq.read_table(path, columns=names, filters=rows), chosen=rows is not None
    )


def read_groups(path: Path, table: Table, columns: Sequence[str] = ()) -> Iterator[pd.DataFrame]:
    """Read a parquet file as `read` does, one row group after the other; keys are compared within a group alone."""
    try:
        groups = pq.read_metadata(path).num_row_groups
    except Exception as error:  # as in _read
        raise _unreadable(path, error) from error
    if groups < 2:
        yield read(path, table, columns)
        return
    with pq.ParquetFile(path) as file:
        for group in range(groups):
            yield _read(path, table, columns, functools.partial(file.read_row_group, group))


def _read(
    path: Path,
    table: Table,
    columns: Sequence[str],
    rows: Callable[[list[str] | None], pa.Table],
    *,
    chosen: bool = False,
) -> pd.DataFrame:
    """Read and check what `rows` returns for the names of columns; none may be `chosen` from the rows of the file."""
    try:
        schema = pq.read_schema(path)
        table = table.of_file(schema.names)
        names = _present(path, table, columns, schema.names)
        if not (table.may_be_empty and pq.read_metadata(path).num_rows == 0):
            # Types are checked before reading, because the filter by sequence fails on a column that is not numeric.
            for name in names:
                _check_kind(path, name, table.columns[name], schema.field(name).type)
        found = rows(names if columns else None)
        frame = found.to_pandas()
    except InputError:
        raise
    except Exception as error:  # pyarrow, and pandas for damaged metadata, raise many types of exceptions
        raise _unreadable(path, error) from error
    lost = [name for name in names if name not in frame]
    if lost:
        raise InputError(f"{path}: can't be read as parquet (its metadata take column {lost[0]} for an index)")
    if not found.num_rows:
        if table.may_be_empty or chosen:
            return frame
        raise InputError(f"{path}: expected at least one row, found none")
    for name in names:
        _check_values(path, name, table, found[name], frame)
    check(path, table, frame)
    return frame


def read_attributes(path: Path) -> dict[str, Any]:
    """Read the attributes of a parquet file (stage, scale and params), or an empty dictionary if it has none.

    Raises InputError if the file can't be read or the attributes are not a JSON object.
    """
    try:
        found = json.loads((pq.read_schema(path).metadata or {}).get(b"clothkit", b"{}"))
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    if not isinstance(found, dict):
        raise InputError(f"{path}: metadata clothkit: expected an object, found {found!r:.50}")
    return found


def check(path: Path, table: Table, frame: pd.DataFrame) -> None:
    """Raises InputError if keys are duplicated, a rule is violated or a row is missing.

    Conditions on columns that the frame lacks are skipped. For the rows of several files, `path` is their folder.
    """
    if table.keys and set(table.keys) <= set(frame):
        again = frame.duplicated(list(table.keys))
        if again.any():
            keys = ", ".join(table.keys)
            raise InputError(f"{path}: expected one row for each {keys}, found two for {_where(frame, table, again)}")
    for columns, holds, expected in table.rules:
        if set(columns) <= set(frame):
            broken = ~np.asarray(holds(frame[list(columns)]), bool)
            if broken.any():
                raise InputError(f"{path}: {', '.join(columns)} of {_where(frame, table, broken)}: expected {expected}")
    for by, columns, rows, expected in table.complete:
        if {*by, *columns} <= set(frame):
            groups = rows(frame).groupby([frame[name] for name in by], sort=False)
            short = groups.size() != groups.max()
            if short.any():
                place = short.index[short.to_numpy()][0]
                named = zip(by, place if isinstance(place, tuple) else (place,), strict=True)
                told = ", ".join(f"{name} {value}" for name, value in named)
                raise InputError(f"{path}: {told}: expected {expected}")


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, OSError) and error.errno is not None:
        return system_error(error, path, expected="a parquet file; run the stage that writes it (dvc repro)")
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    return InputError(f"{path}: can't be read as parquet ({reason})")


def _present(path: Path, table: Table, columns: Sequence[str], there: Sequence[str]) -> list[str]:
    wanted = list(columns) or [name for name, column in table.columns.items() if not column.optional]
    missing = [name for name in wanted if name not in there and not (columns and table.columns[name].optional)]
    if missing:
        raise InputError(f"{path}: has no column {missing[0]}, expected {', '.join(wanted)}")
    chosen = columns or table.columns
    return [name for name in chosen if name in there]


def _check_kind(path: Path, name: str, column: Column, found: pa.DataType) -> None:
    item = found.value_type if pa.types.is_dictionary(found) else found
    if column.kind.startswith(_LIST) and (pa.types.is_list(found) or pa.types.is_large_list(found)):
        right = _KINDS[column.item](found.value_type) or (column.missing and pa.types.is_null(found.value_type))
    else:
        right = not column.kind.startswith(_LIST) and _KINDS[column.kind](item)
    if not right and not (column.missing and pa.types.is_null(found)):
        raise InputError(f"{path}: column {name}: expected {column.expected}, found {found}")


def _check_values(path: Path, name: str, table: Table, values: pa.ChunkedArray, frame: pd.DataFrame) -> None:
    column = table.columns[name]
    if pa.types.is_null(values.type):
        return
    nothing = frame[name].isna()
    if nothing.any() and not column.missing:
        _refuse(path, name, table, frame, nothing, "nothing")
    if column.kind.startswith(_LIST):
        _check_lists(path, name, table, values, frame)
    elif column.among:
        unlisted = ~frame[name].isin(column.among) & ~nothing
        if unlisted.any():
            _refuse(path, name, table, frame, unlisted, repr(frame.loc[unlisted, name].iloc[0])[:60])
    elif column.kind.endswith("numbers"):
        wrong = _wrong(column, frame[name].to_numpy(np.float64, na_value=np.nan))
        if wrong.any():
            _refuse(path, name, table, frame, wrong, f"{frame.loc[wrong, name].iloc[0]:g}")


def _check_lists(path: Path, name: str, table: Table, values: pa.ChunkedArray, frame: pd.DataFrame) -> None:
    if pa.types.is_null(values.type.value_type):
        return
    first = 0
    for chunk in values.chunks:
        # The conversion to NumPy turns null items into NaN.
        items = chunk.flatten().to_numpy(zero_copy_only=False)
        if not _extremes_valid(table.columns[name], items) and (wrong := _wrong(table.columns[name], items)).any():
            item = int(np.argmax(wrong))
            row = first + pc.list_parent_indices(chunk)[item].as_py()
            _refuse(path, name, table, frame, np.arange(len(frame)) == row, f"{items[item]:g}")
        first += len(chunk)


def _extremes_valid(column: Column, values: np.ndarray) -> bool:
    """Whether minimum and maximum alone show that all values are valid: a fast test for millions of coordinates."""
    if not len(values):
        return True
    low, high = values.min(), values.max()
    return bool(np.isfinite(low) and np.isfinite(high) and column.least <= low and high <= column.most)


def _wrong(column: Column, values: np.ndarray) -> np.ndarray:
    """Mask of the invalid numbers. NaN is invalid unless values may be missing."""
    right = (values >= column.least) & (values <= column.most) & (column.infinite | np.isfinite(values))
    return ~(right | np.isnan(values)) if column.missing else ~right


def _refuse(
    path: Path, name: str, table: Table, frame: pd.DataFrame, wrong: np.ndarray | pd.Series, found: str
) -> NoReturn:
    where, expected = _where(frame, table, wrong), table.columns[name].expected
    raise InputError(f"{path}: column {name}: expected {expected}, found {found} ({where})")


def _where(frame: pd.DataFrame, table: Table, wrong: np.ndarray | pd.Series) -> str:
    """The first wrong row in words, for error messages: its keys or, if it has none, its number."""
    place = int(np.argmax(np.asarray(wrong)))
    if table.keys and set(table.keys) <= set(frame):
        return ", ".join(f"{key} {frame[key].iloc[place]}" for key in table.keys)
    return f"row {place}"

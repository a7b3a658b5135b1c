"""The parts of a report's section as `sections.py` declares them, and the blocks that they make of a report's data."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import pandas as pd

from clothkit.report import blocks, budgets, captions
from clothkit.report.budgets import DAGGER
from clothkit.report.contents import Contents
from clothkit.report.formatting import JUDGED
from clothkit.report.layout import LABELLED

W = TypeVar("W", bound=str | Sequence[str])

PREDICTORS = {"a2": "b4", "main_occluded": "main"}
"""For systems of table 4, the planner that uses the same forward models."""


@dataclass(frozen=True)
class Report:
    """The data of a report, from which the entries make their blocks."""

    contents: Contents
    budgets: pd.DataFrame
    """The table of `budgets.budgets`."""

    def table(self, name: str) -> pd.DataFrame:
        """A table of the report by name; an empty table if the report lacks it."""
        return self.contents.tables.get(name, pd.DataFrame())

    def marked(self, system: str, against: str = "main") -> str:
        """The name of a system, with a dagger if its budget differs from that of `against`."""
        one, other = (PREDICTORS.get(name, name) for name in (system, against))
        return system + DAGGER * budgets.differ(self.budgets, one, other)


Words = str | Callable[[Report], str]
"""A paragraph in Markdown, or a function that makes it of a report; an empty one is left out."""


@dataclass(frozen=True)
class Text:
    """Paragraphs."""

    words: str | Callable[[Report], str | Sequence[str]]
    only: blocks.Renderer | None = None
    """The one renderer that shows them; None: both."""

    def blocks(self, report: Report) -> Iterator[blocks.Block]:
        """A block for each paragraph that is not empty."""
        found = _resolved(self.words, report)
        yield from (
            blocks.Paragraph(text, self.only) for text in ([found] if isinstance(found, str) else found) if text
        )


@dataclass(frozen=True)
class Figure:
    """A picture; it is there if the report stage, or a study, has drawn it."""

    name: str
    title: str
    """A figure that is also in the paper has the paper's number."""
    caption: str
    """In Markdown. Pictures that were drawn by older code keep the captions that are stored beside them."""
    file: str = ""
    """Path of a study's picture in the report's folder; empty: `figures/<name>.png`."""

    def blocks(self, report: Report) -> Iterator[blocks.Block]:
        """The picture, if it is there."""
        if self.file in report.contents.drawn:
            yield blocks.Picture(self.name, self.title, self.caption, self.file)
        elif self.name in report.contents.figures:
            yield blocks.Picture(self.name, self.title, report.contents.figures[self.name])


@dataclass(frozen=True)
class Table:
    """A table; it is there if it has rows, and so do the tables that it needs."""

    name: str
    title: str
    columns: tuple[str, ...] = ()
    """Columns that its CSV must have; empty for a table that is made of others."""
    words: tuple[Words, ...] = ()
    """The paragraphs above it."""
    rows: Callable[[Report, pd.DataFrame], pd.DataFrame] = lambda _, rows: rows
    """The rows that are shown, from those of its CSV."""
    needs: tuple[str, ...] = ()
    keys: tuple[str, ...] = ()
    """As `blocks.DataTable.keys`, as are the following ones."""
    judged: Collection[str] | Callable[[Report], Collection[str]] = JUDGED
    ideal: float = -math.inf
    heads: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    noted: bool | Callable[[Report], bool] = False
    """Whether a note stands in its place where it is not there."""
    file: str = ""
    """Path of its CSV in the report's folder; empty: `tables/<name>.csv`."""

    @property
    def csv(self) -> str:
        """Path of its CSV in the report's folder."""
        return self.file or f"tables/{self.name}.csv"

    def blocks(self, report: Report) -> Iterator[blocks.Block]:
        """The table, or a note in its place."""
        needed = (*([self.name] if self.columns else []), *self.needs)
        own, there = report.table(self.name), not any(report.table(name).empty for name in needed)
        data = self.rows(report, own) if there else pd.DataFrame()
        if not data.empty:
            yield blocks.DataTable(
                self.title,
                data,
                self.csv,
                [text for text in (_resolved(words, report) for words in self.words) if text],
                self.keys,
                self.judged(report) if callable(self.judged) else self.judged,
                self.ideal,
                self.heads,
                self.unit,
            )
        elif self.noted(report) if callable(self.noted) else self.noted:
            yield blocks.Note(self.title, captions.MISSING)


class Card(NamedTuple):
    """A figure in large print: a mean on the test set; it is there if its table is."""

    title: str
    table: str
    by: str
    """The column that identifies the table's rows."""
    row: str
    column: str
    meaning: str


@dataclass(frozen=True)
class Cards:
    """The most important figures in large print, each with the paper's figure and a sentence on its meaning."""

    cards: tuple[Card, ...]

    def blocks(self, report: Report) -> Iterator[blocks.Block]:
        """One block with the cards whose tables are there."""
        shown = [card for card in self.cards if card.table in report.contents.tables]
        yield blocks.Cards([_card(report.table(card.table), card) for card in shown])


@dataclass(frozen=True)
class Timings:
    """A table of every stage's time and memory, which is read from `<name>.csv`."""

    name: str
    title: str
    columns: tuple[str, ...]
    words: str

    @property
    def csv(self) -> str:
        """Path of its CSV in the report's folder."""
        return f"{self.name}.csv"

    def blocks(self, report: Report) -> Iterator[blocks.Block]:
        """The table, which may be empty."""
        yield blocks.Timings(self.title, self.words, self.csv, report.table(self.name))


@dataclass(frozen=True)
class Folded:
    """Preformatted text that is folded away."""

    title: str
    text: Words

    def blocks(self, report: Report) -> Iterator[blocks.Block]:
        """The text."""
        yield blocks.Folded(self.title, _resolved(self.text, report))


Entry = Text | Figure | Table | Cards | Timings | Folded


@dataclass(frozen=True)
class Section:
    """A part of the page; it is there if one of the tables that it needs is, and if it has a block."""

    id: str
    title: str
    entries: tuple[Entry, ...]
    needs: tuple[str, ...] = ()
    """Empty: it needs none."""

    def resolve(self, report: Report) -> blocks.Section | None:
        """The section with its data; None where it is not there."""
        found = [block for entry in self.entries for block in entry.blocks(report)]
        missing = bool(self.needs) and all(report.table(name).empty for name in self.needs)
        return None if missing or not found else blocks.Section(self.id, self.title, found)


def _resolved(words: W | Callable[[Report], W], report: Report) -> W:
    return words(report) if callable(words) else words


def _card(table: pd.DataFrame, card: Card) -> blocks.Card:
    rows = table[table["split"] == "test"]
    means, labelled = rows[rows["statistic"] == "mean"], rows[rows["statistic"] == LABELLED]
    return blocks.Card(
        card.title,
        own=_figure(means, "clothkit", card, card.row),
        paper=_figure(means, "paper", card, card.row),
        no_action=_figure(means, "clothkit", card, "no action"),
        labelled=_figure(labelled, "clothkit", card, card.row),
        meaning=card.meaning,
    )


def _figure(rows: pd.DataFrame, source: str, card: Card, row: str) -> float:
    found = rows.loc[(rows["source"] == source) & (rows[card.by] == row), card.column]
    return float(found.iloc[0]) if len(found) else math.nan

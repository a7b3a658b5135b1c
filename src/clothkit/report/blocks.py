"""The blocks of a page, independent of the renderer: sections of paragraphs, pictures and tables."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from clothkit.report.printed import JUDGED


@dataclass(frozen=True)
class Text:
    """A paragraph in Markdown."""

    words: str


@dataclass(frozen=True)
class Figure:
    """A picture in the report's folder."""

    name: str
    caption: str
    """In Markdown."""


@dataclass(frozen=True)
class Table:
    """A table with its heading and the paragraphs above it."""

    name: str
    """Name of its CSV."""
    title: str
    data: pd.DataFrame
    words: Sequence[str] = ()
    """Paragraphs in Markdown."""
    keys: Sequence[str] = ()
    """Columns that identify a row in a table with the paper's figures beside ours; empty for other tables."""
    judged: Collection[str] = JUDGED
    """Values of the last key in whose rows the better of our figure and the paper's is marked."""
    ideal: float = -math.inf
    heads: Mapping[str, str] = field(default_factory=dict)
    """Longer names of columns, for renderers that have room for them."""
    unit: str = ""
    file: str = ""
    """Path of its CSV in the report's folder; empty: `tables/<name>.csv`."""

    @property
    def csv(self) -> str:
        """Path of its CSV in the report's folder."""
        return self.file or f"tables/{self.name}.csv"


@dataclass(frozen=True)
class Missing:
    """The place of a table that the report lacks because it is older than the table."""

    title: str


@dataclass(frozen=True)
class Cards:
    """The most important figures in large print, for renderers that can show them."""


@dataclass(frozen=True)
class Stages:
    """Time and memory of every stage."""

    timings: pd.DataFrame


@dataclass(frozen=True)
class Params:
    """The settings that the report was made with."""


Block = Text | Figure | Table | Missing | Cards | Stages | Params


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    id: str
    title: str
    blocks: Sequence[Block]

"""What a page is made of, whoever renders it: sections of paragraphs, pictures and tables."""

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
    """A picture that was drawn."""

    name: str
    caption: str
    """In Markdown."""


@dataclass(frozen=True)
class Table:
    """A table with its heading and what is told of it."""

    name: str
    """Of its CSV."""
    title: str
    data: pd.DataFrame
    words: Sequence[str] = ()
    """Paragraphs in Markdown."""
    keys: Sequence[str] = ()
    """What tells the rows of a table apart that has the paper's figures beside ours; other tables stand as they are."""
    judged: Collection[str] = JUDGED
    """Values of the last key that have the better of two figures marked."""
    ideal: float = -math.inf
    heads: Mapping[str, str] = field(default_factory=dict)
    """How columns are called where there is room."""
    unit: str = ""
    file: str = ""
    """Its CSV, in the report's folder."""

    @property
    def csv(self) -> str:
        """Its CSV, in the report's folder."""
        return self.file or f"tables/{self.name}.csv"


@dataclass(frozen=True)
class Missing:
    """A table that an older report lacks."""

    title: str


@dataclass(frozen=True)
class Cards:
    """The figures that say most, large, where a page can show them so."""


@dataclass(frozen=True)
class Stages:
    """What every stage cost."""

    timings: pd.DataFrame


@dataclass(frozen=True)
class Params:
    """What the report was made with."""


Block = Text | Figure | Table | Missing | Cards | Stages | Params


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    id: str
    title: str
    blocks: Sequence[Block]

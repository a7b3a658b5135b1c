"""The blocks of a page with their data, which the renderers show: sections of paragraphs, pictures and tables.

`entries.py` makes them from the list of sections; a renderer knows nothing about the sections.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import pandas as pd

from clothkit.report.formatting import JUDGED

Renderer = Literal["markdown", "html"]


@dataclass(frozen=True)
class Paragraph:
    """A paragraph in Markdown."""

    text: str
    only: Renderer | None = None
    """The one renderer that shows it; None: both."""


@dataclass(frozen=True)
class Picture:
    """A picture in the report's folder."""

    name: str
    title: str
    caption: str
    """In Markdown."""
    file: str = ""
    """Path of its PNG in the report's folder; empty: `figures/<name>.png`."""

    @property
    def png(self) -> str:
        """Path of its PNG in the report's folder."""
        return self.file or f"figures/{self.name}.png"


@dataclass(frozen=True)
class DataTable:
    """A table with its heading and the paragraphs above it."""

    title: str
    data: pd.DataFrame
    csv: str
    """Path of its CSV in the report's folder."""
    paragraphs: Sequence[str] = ()
    """In Markdown, none empty."""
    keys: Sequence[str] = ()
    """Columns that identify a row in a table with the paper's figures beside ours; empty for other tables."""
    judged: Collection[str] = JUDGED
    """Values of the last key in whose rows the better of our figure and the paper's is marked."""
    ideal: float = -math.inf
    heads: Mapping[str, str] = field(default_factory=dict)
    """Longer names of columns, for renderers that have room for them."""
    unit: str = ""


@dataclass(frozen=True)
class Note:
    """A heading with a paragraph in place of a table that the report lacks."""

    title: str
    text: str


class Card(NamedTuple):
    """One of the most important figures, a mean on the test set [cloth length]; figures that are missing are NaN."""

    title: str
    own: float
    paper: float
    no_action: float
    labelled: float
    meaning: str


@dataclass(frozen=True)
class Cards:
    """The most important figures in large print; only HTML shows them."""

    cards: Sequence[Card]


@dataclass(frozen=True)
class Timings:
    """A table of every stage's time and memory, with bars; only HTML shows it."""

    title: str
    paragraph: str
    csv: str
    data: pd.DataFrame


@dataclass(frozen=True)
class Folded:
    """Preformatted text that is folded away; only HTML shows it."""

    title: str
    text: str


Block = Paragraph | Picture | DataTable | Note | Cards | Timings | Folded


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    id: str
    title: str
    blocks: Sequence[Block]

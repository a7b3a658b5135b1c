"""Renders the report's sections as one HTML file, from a template."""

from dataclasses import dataclass
from functools import partial, singledispatchmethod
from pathlib import Path
from string import Template

from clothkit.report.blocks import Block, Cards, DataTable, Folded, Note, Paragraph, Picture, Section, Timings
from clothkit.report.html import tables
from clothkit.report.html.cards import card
from clothkit.report.html.elements import Html, element, inline, joined, paragraph
from clothkit.report.html.pictures import picture
from clothkit.report.html.timings import timings
from clothkit.report.layout import SPLITS

HERE = Path(__file__).parent


def page(title: str, sections: list[Section], folder: Path) -> str:
    """The page as one HTML document, with the pictures of a report's folder. Equal sections give equal bytes."""
    writer = _Writer(folder)
    links = [element("li", element("a", section.title, href=f"#{section.id}")) for section in sections]
    parts = []
    for section in sections:
        blocks = joined(*(writer.render(block) for block in section.blocks))
        # Each section is one line, so that `git diff` of two pages shows which sections differ.
        parts.append(Html("\n" + element("section", element("h2", section.title), blocks, id=section.id)))
    return Template((HERE / "template.html").read_text()).substitute(
        title=title,
        style=(HERE / "style.css").read_text(),
        links=element("ul", *links),
        body=joined(*parts),
    )


@dataclass(frozen=True)
class _Writer:
    folder: Path

    @singledispatchmethod
    def render(self, block: Block) -> Html:
        """A block as HTML."""
        raise TypeError(f"no block of a page: {type(block).__name__}")

    @render.register
    def _(self, block: Paragraph) -> Html:
        return Html() if block.only == "markdown" else paragraph(block.text)

    @render.register
    def _(self, block: Picture) -> Html:
        return picture(block, self.folder / block.png)

    @render.register
    def _(self, block: DataTable) -> Html:
        csv = element("p", inline(f"[CSV]({block.csv})"))
        # GitHub makes the same anchors from the Markdown page's headings, so that links work on both pages.
        anchor = block.title.lower().replace(" ", "-").replace(":", "").replace(",", "")
        return joined(element("h3", block.title, id=anchor), *map(paragraph, block.paragraphs), csv, _shown(block))

    @render.register
    def _(self, block: Note) -> Html:
        return joined(element("h3", block.title), paragraph(block.text))

    @render.register
    def _(self, block: Cards) -> Html:
        return element("div", *map(card, block.cards), class_="cards")

    @render.register
    def _(self, block: Timings) -> Html:
        return timings(block)

    @render.register
    def _(self, block: Folded) -> Html:
        text = element("pre", block.text, tabindex=0, role="region", aria_label=block.title)
        return element("details", element("summary", block.title), text)


def _shown(block: DataTable) -> Html:
    """The table as HTML. A table by split is cut in two: the test set, then the training set in a closed <details>."""
    paired = partial(tables.paired, heads=block.heads, unit=block.unit, judged=block.judged, ideal=block.ideal)
    if not block.keys:
        return tables.plain(block.data, label=block.title)
    if block.keys[0] != "split" or len(block.keys) == 1:
        return paired(block.data, block.keys, label=block.title)
    parts = []
    for split, words in SPLITS.items():
        rows = block.data[block.data["split"] == split].drop(columns="split")
        if rows.empty:
            continue
        table = paired(rows, block.keys[1:], label=f"{block.title}, {words.lower()}")
        if split == "test":
            parts += [element("h4", words), table]
        else:
            parts.append(element("details", element("summary", words), table))
    return joined(*parts)

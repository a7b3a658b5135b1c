"""Renders the report's sections as one HTML file, from a template."""

from dataclasses import dataclass
from functools import partial, singledispatchmethod
from pathlib import Path
from string import Template

from clothkit.report import captions
from clothkit.report.blocks import Block, Cards, Figure, Missing, Params, Section, Stages, Table, Text
from clothkit.report.contents import Contents
from clothkit.report.html import costs, tables
from clothkit.report.html.elements import Html, element, inline, joined, paragraph
from clothkit.report.html.headline import headline
from clothkit.report.html.pictures import picture
from clothkit.report.sections import SPLITS

HERE = Path(__file__).parent


def page(contents: Contents, sections: list[Section], figures: Path) -> str:
    """The page as one HTML document, with the pictures in the folder `figures`. Equal contents give equal bytes."""
    writer = _Writer(contents, figures)
    links = [element("li", element("a", section.title, href=f"#{section.id}")) for section in sections]
    parts = []
    for section in sections:
        blocks = joined(*(writer.render(block) for block in section.blocks))
        # Each section is one line, so that `git diff` of two pages shows which sections differ.
        parts.append(Html("\n" + element("section", element("h2", section.title), blocks, id=section.id)))
    return Template((HERE / "template.html").read_text()).substitute(
        title=f"Report: {contents.made_with.scale}",
        style=(HERE / "style.css").read_text(),
        links=element("ul", *links),
        body=joined(*parts),
    )


@dataclass(frozen=True)
class _Writer:
    contents: Contents
    figures: Path

    @singledispatchmethod
    def render(self, block: Block) -> Html:
        """A block as HTML."""
        raise TypeError(f"no block of a page: {type(block).__name__}")

    @render.register
    def _(self, block: Text) -> Html:
        return paragraph(block.words) if block.words else Html()

    @render.register
    def _(self, block: Figure) -> Html:
        return picture(block.name, block.caption, self.figures / f"{block.name}.png")

    @render.register
    def _(self, block: Table) -> Html:
        words = [paragraph(words) for words in block.words if words]
        csv = element("p", inline(f"[CSV]({block.csv})"))
        # GitHub makes the same anchors from the Markdown page's headings, so that links work on both pages.
        anchor = block.title.lower().replace(" ", "-").replace(":", "").replace(",", "")
        return joined(element("h3", block.title, id=anchor), *words, csv, _shown(block))

    @render.register
    def _(self, block: Missing) -> Html:
        return joined(element("h3", block.title), paragraph(captions.MISSING))

    @render.register
    def _(self, block: Cards) -> Html:
        return headline(self.contents)

    @render.register
    def _(self, block: Stages) -> Html:
        return costs.costs(block.timings)

    @render.register
    def _(self, block: Params) -> Html:
        text = element("pre", self.contents.made_with.text, tabindex=0, role="region", aria_label="params.yaml")
        links = "[params.yaml](params.yaml), [metrics.json](metrics.json), [the same as Markdown](README.md)."
        return joined(paragraph(links), element("details", element("summary", "params.yaml"), text))


def _shown(block: Table) -> Html:
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

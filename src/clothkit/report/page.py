"""Renders the report's sections as one Markdown page, to be read on the web."""

from functools import singledispatch

from clothkit.report import captions, markdown
from clothkit.report.blocks import Block, Cards, Figure, Missing, Params, Section, Stages, Table, Text


def page(scale: str, sections: list[Section]) -> str:
    """The page as a Markdown string, with links to the files beside it.

    The first section has no heading, so that its text follows the title directly.
    """
    parts = [f"# Report: {scale}\n"]
    for place, section in enumerate(sections):
        shown = [render(block) for block in section.blocks]
        parts += [f"## {section.title}\n"] * (place > 0 and any(shown)) + shown
    return "\n".join(part for part in parts if part)


@singledispatch
def render(block: Block) -> str:
    """A block as Markdown; "" for blocks that only the HTML page shows."""
    raise TypeError(f"no block of a page: {type(block).__name__}")


@render.register
def _(block: Text) -> str:
    return block.words


@render.register
def _(block: Figure) -> str:
    return f"![{block.name}](figures/{block.name}.png)\n\n*{block.caption}*\n"


@render.register
def _(block: Table) -> str:
    if block.keys:
        table = markdown.table(block.data, block.keys, judged=block.judged, ideal=block.ideal)
    else:
        table = markdown.plain(block.data)
    marks = (
        f"In bold: the better of our figure and the paper's. [CSV]({block.csv})\n"
        if block.keys
        else f"[CSV]({block.csv})\n"
    )
    return "\n".join(part for part in (f"### {block.title}\n", *block.words, marks, table) if part)


@render.register
def _(block: Missing) -> str:
    return f"### {block.title}\n\n{captions.MISSING}"


@render.register
def _(block: Cards) -> str:
    return ""


@render.register
def _(block: Stages) -> str:
    return "[Seconds and memory of every stage](timings.csv), of the stages' last runs on this machine.\n"


@render.register
def _(block: Params) -> str:
    return "[params.yaml](params.yaml), [metrics.json](metrics.json).\n"

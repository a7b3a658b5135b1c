"""Renders the report's sections as one Markdown page, to be read on the web."""

from functools import singledispatch

from clothkit.report.blocks import Block, Cards, DataTable, Folded, Note, Paragraph, Picture, Section, Timings
from clothkit.report.markdown import tables


def page(title: str, sections: list[Section]) -> str:
    """The page as a Markdown string, with links to the files beside it.

    The first section has no heading, so that its text follows the title directly.
    """
    parts = [f"# {title}\n"]
    for place, section in enumerate(sections):
        shown = [render(block) for block in section.blocks]
        parts += [f"## {section.title}\n"] * (place > 0 and any(shown)) + shown
    return "\n".join(part for part in parts if part)


@singledispatch
def render(block: Block) -> str:
    """A block as Markdown; "" for blocks that only the HTML page shows."""
    raise TypeError(f"no block of a page: {type(block).__name__}")


@render.register
def _(block: Paragraph) -> str:
    return "" if block.only == "html" else block.text


@render.register
def _(block: Picture) -> str:
    return f"![{block.name}]({block.png})\n\n*{block.caption}*\n"


@render.register
def _(block: DataTable) -> str:
    csv = f"[CSV]({block.csv})\n"
    if block.keys:
        if (block.data["source"] == "paper").any():
            csv = f"In bold: the better of our figure and the paper's. {csv}"
        table = tables.paired(block.data, block.keys, judged=block.judged, ideal=block.ideal)
    else:
        table = tables.plain(block.data)
    return "\n".join((f"### {block.title}\n", *block.paragraphs, csv, table))


@render.register
def _(block: Note) -> str:
    return f"### {block.title}\n\n{block.text}"


@render.register(Cards)
@render.register(Timings)
@render.register(Folded)
def _(block: Block) -> str:
    return ""

"""A page of made-up tables and small pictures, and its markup as a tree."""

from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

from clothkit.report.html.page import page
from clothkit.report.sections import CAPTIONS, DRAWN
from tests.evaluation.planning_rows import SYSTEMS
from tests.report.contents import contents_of, parts_of

VOID = ("img", "meta", "link", "br")


@dataclass
class Node:
    """An element, or text: a node without a name."""

    name: str = ""
    attributes: dict[str, str] = field(default_factory=dict)
    children: list["Node"] = field(default_factory=list)
    own: str = ""

    @property
    def text(self) -> str:
        return self.own + "".join(child.text for child in self.children)

    def all(self, name: str = "", **attributes: str) -> list["Node"]:
        """Its descendants of that name with those attributes, in order."""
        found = []
        for child in self.children:
            given = all(child.attributes.get(key.rstrip("_")) == value for key, value in attributes.items())
            if child.name and name in ("", child.name) and given:
                found.append(child)
            found += child.all(name, **attributes)
        return found


class _Tree(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open = [Node("document")]

    def handle_starttag(self, tag: str, attrs: list) -> None:
        node = Node(tag, {name: value or "" for name, value in attrs})
        self.open[-1].children.append(node)
        if tag not in VOID:
            self.open.append(node)

    def handle_endtag(self, tag: str) -> None:
        assert self.open[-1].name == tag, f"</{tag}> closes <{self.open[-1].name}>"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        self.open[-1].children.append(Node(own=data))


def tree(markup: str) -> Node:
    """The document's tree; every element must be closed, by its own tag."""
    parser = _Tree()
    parser.feed(markup)
    parser.close()
    assert len(parser.open) == 1
    return parser.open[0]


def made_up_page(folder: Path) -> str:
    """A page of every table and every figure, pictures as wide as the real ones."""
    shown = contents_of(folder, SYSTEMS, list(CAPTIONS), DRAWN)
    return page("Report: laptop", parts_of(shown), folder)

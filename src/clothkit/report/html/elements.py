"""Builds HTML markup: text is escaped unless it is markup already, and attributes keep their order."""

import re
from html import escape

_VOID = ("img", "meta", "br")


class Html(str):
    """Text that is markup already."""


def element(tag: str, *children: str, **attributes: str | int | None) -> Html:
    """An element. `children` that are not Html are escaped; attributes that are None are left out.

    In names of attributes, an underscore at the end is dropped and others become hyphens: `class_`, `aria_label`.
    """
    attribute_text = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(str(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    start = f"<{tag}{attribute_text}>"
    return Html(start if tag in _VOID else f"{start}{joined(*children)}</{tag}>")


def joined(*parts: str) -> Html:
    """The parts concatenated; parts that are not Html are escaped."""
    return Html("".join(part if isinstance(part, Html) else escape(part, quote=False) for part in parts))


def inline(markdown: str) -> Html:
    """HTML of inline Markdown, limited to the marks in the report's texts: *emphasis*, `code` and [links](to)."""
    text = escape(markdown.strip(), quote=False)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    text = re.sub(r"\[([^\]]+)\]\(([^)\s]+)\)", r'<a href="\2">\1</a>', text)
    return Html(re.sub(r"\*([^*]+)\*", r"<em>\1</em>", text))


def unmarked(markdown: str) -> str:
    """The text of inline Markdown without marks, for alternative texts."""
    return re.sub(r"\[([^\]]+)\]\([^)\s]+\)", r"\1", markdown.strip()).replace("*", "").replace("`", "")


def paragraph(markdown: str) -> Html:
    """A paragraph of inline Markdown."""
    return element("p", inline(markdown))

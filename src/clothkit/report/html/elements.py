"""Markup from Python: escaped unless it is markup already, attributes in the order in which they are given."""

import re
from html import escape

_VOID = ("img", "meta", "br")


class Html(str):
    """Text that is markup already."""


def element(tag: str, *children: str, **attributes: str | int | None) -> Html:
    """An element; `children` that are no Html are escaped, attributes that are None left out.

    An underscore at an attribute's end is dropped, those inside are hyphens: `class_`, `aria_label`.
    """
    given = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{escape(str(value))}"'
        for name, value in attributes.items()
        if value is not None
    )
    start = f"<{tag}{given}>"
    return Html(start if tag in _VOID else f"{start}{joined(*children)}</{tag}>")


def joined(*parts: str) -> Html:
    """Parts one after the other; those that are no Html are escaped."""
    return Html("".join(part if isinstance(part, Html) else escape(part, quote=False) for part in parts))


def inline(markdown: str) -> Html:
    """The few marks that the report's words use: *emphasis*, `code` and [links](to)."""
    text = escape(markdown.strip(), quote=False)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    text = re.sub(r"\[([^\]]+)\]\(([^)\s]+)\)", r'<a href="\2">\1</a>', text)
    return Html(re.sub(r"\*([^*]+)\*", r"<em>\1</em>", text))


def unmarked(markdown: str) -> str:
    """The same words without their marks, for alternative texts."""
    return re.sub(r"\[([^\]]+)\]\([^)\s]+\)", r"\1", markdown.strip()).replace("*", "").replace("`", "")


def paragraph(markdown: str) -> Html:
    """A paragraph of `inline` text."""
    return element("p", inline(markdown))

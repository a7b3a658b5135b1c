"""The reference's docstrings and annotations, as they stand in the source.

Docstrings are plain text, whose equations become links. Where a setting has none, the comment behind it takes its
place. Strings in annotations are shapes: `"n *batch"` is no product.
"""

import ast
import re
from pathlib import Path
from typing import Any

import griffe

_EQUATION = re.compile(r"\beq(s?)\. \((\d+)\)")
_CODE = re.compile(r"(`[^`]*`)")
_COMMENT = re.compile(r"^[^#\"']*?\s{2}# (.*)$")


class Docstrings(griffe.Extension):
    """Loaded by mkdocstrings, see mkdocs.yml."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Escape what Markdown would take for emphasis, links or tags; link equations."""
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)

    def on_function_instance(self, *, node: Any, func: griffe.Function, **_: Any) -> None:
        """Annotations with their shapes."""
        every = node.args
        for given in (*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg):
            if given is not None and given.annotation is not None:
                func.parameters[given.arg].annotation = annotation(given.annotation, func)
        if node.returns is not None:
            func.returns = annotation(node.returns, func)

    def on_attribute_instance(self, *, node: Any, attr: griffe.Attribute, **_: Any) -> None:
        """Likewise; and a setting's unit stands in a comment behind it."""
        if isinstance(node, ast.AnnAssign) and isinstance(attr.parent, griffe.Class | griffe.Module):
            attr.annotation = annotation(node.annotation, attr.parent)
        if attr.docstring or attr.lineno is None or attr.lineno != attr.endlineno:
            return
        assert isinstance(attr.filepath, Path)
        found = _COMMENT.match(attr.lines_collection[attr.filepath][attr.lineno - 1])
        if found:
            attr.docstring = griffe.Docstring(found[1], parent=attr)


def annotation(node: Any, parent: Any) -> Any:
    """An annotation whose strings are shapes, unless it is nothing but a string: the name of a class to come."""
    named = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return griffe.get_expression(node, parent=parent, parse_strings=named)


def as_markdown(text: str) -> str:
    """A docstring as Markdown that shows it as it is."""
    parts = _CODE.split(text)
    for i in range(0, len(parts), 2):
        plain = re.sub(r"([*<\[\]$])", r"\\\1", parts[i])
        parts[i] = _EQUATION.sub(r"[eq\1. (\2)][eq-\2]", plain)
    return "".join(parts)

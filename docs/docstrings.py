"""A griffe extension that shows docstrings and annotations in the reference as they are in the source.

Docstrings are plain text in which equation numbers become links. A setting without a docstring gets the comment at the
end of its line. Strings in annotations are shapes, not expressions: `"n *batch"` is not a product.
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
    """The extension, which mkdocstrings loads (see mkdocs.yml)."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Escape characters that Markdown would read as emphasis, links or tags, and link equations."""
        if obj.docstring:
            obj.docstring.value = as_markdown(obj.docstring.value)

    def on_function_instance(self, *, node: Any, func: griffe.Function, **_: Any) -> None:
        """Replace the annotations of parameters and of the result by annotations with shapes."""
        every = node.args
        for given in (*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg):
            if given is not None and given.annotation is not None:
                func.parameters[given.arg].annotation = annotation(given.annotation, func)
        if node.returns is not None:
            func.returns = annotation(node.returns, func)

    def on_attribute_instance(self, *, node: Any, attr: griffe.Attribute, **_: Any) -> None:
        """Replace the annotation of an attribute, and use the comment on its line if it has no docstring."""
        if isinstance(node, ast.AnnAssign) and isinstance(attr.parent, griffe.Class | griffe.Module):
            attr.annotation = annotation(node.annotation, attr.parent)
        if attr.docstring or attr.lineno is None or attr.lineno != attr.endlineno:
            return
        assert isinstance(attr.filepath, Path)
        found = _COMMENT.match(attr.lines_collection[attr.filepath][attr.lineno - 1])
        if found:
            attr.docstring = griffe.Docstring(found[1], parent=attr)


def annotation(node: Any, parent: Any) -> Any:
    """Return an annotation whose strings are kept as shapes.

    An annotation that is only a string is the name of a class (a forward reference) and is parsed.
    """
    named = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return griffe.get_expression(node, parent=parent, parse_strings=named)


def as_markdown(text: str) -> str:
    """Return a docstring as Markdown that renders to the same text, with equation numbers as links."""
    parts = _CODE.split(text)
    for i in range(0, len(parts), 2):
        plain = re.sub(r"([*<\[\]$])", r"\\\1", parts[i])
        parts[i] = _EQUATION.sub(r"[eq\1. (\2)][eq-\2]", plain)
    return "".join(parts)

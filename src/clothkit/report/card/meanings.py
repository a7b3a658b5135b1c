"""What settings mean: the words beside them in the code are their only documentation, so they are read there.

A settings class has a docstring below a field, or a comment behind it, with its unit.
"""

import ast
import dataclasses
import inspect
import io
import textwrap
import tokenize
from collections.abc import Mapping
from typing import Any

import pandas as pd


def meanings(config: type) -> dict[str, str]:
    """The words beside every field of a settings class and of those nested in it, by dotted name."""
    source = textwrap.dedent(inspect.getsource(config))
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    comments = {t.start[0]: t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT}
    body = next(node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)).body
    words = {}
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            below = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
            words[node.target.id] = " ".join(str(below).split()) or comments.get(node.end_lineno or 0, "")
    for field in dataclasses.fields(config):
        if isinstance(field.type, type) and dataclasses.is_dataclass(field.type):
            del words[field.name]
            words |= {f"{field.name}.{name}": text for name, text in meanings(field.type).items()}
    return words


def flatten(settings: Mapping[str, Any], *, above: str = "") -> dict[str, Any]:
    """Nested settings by dotted name."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        flat |= flatten(value, above=f"{above}{name}.") if isinstance(value, Mapping) else {above + name: value}
    return flat


def settings_table(params: Mapping[str, Any], config: type) -> pd.DataFrame:
    """A row per setting that artifacts were made with: setting, value, meaning (empty where the code knows none)."""
    words = meanings(config)
    rows = [(name, str(value), words.get(name, "")) for name, value in flatten(params).items()]
    return pd.DataFrame(rows, columns=["setting", "value", "meaning"])

"""Reads the meanings of settings from the source code, which is the only place where they are documented.

In a settings class, a docstring below a field or a comment behind it gives its meaning and unit.
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
    """The docstring or comment of every field of a settings class and of the classes nested in it, by dotted name."""
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
    """Nested settings as one dictionary with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        flat |= flatten(value, above=f"{above}{name}.") if isinstance(value, Mapping) else {above + name: value}
    return flat


def settings_table(params: Mapping[str, Any], config: type) -> pd.DataFrame:
    """A row per setting in `params`: setting, value, meaning (empty if `config` has no such field)."""
    words = meanings(config)
    rows = [(name, str(value), words.get(name, "")) for name, value in flatten(params).items()]
    return pd.DataFrame(rows, columns=["setting", "value", "meaning"])

"""Hooks by which mkdocs builds this site.

A line `{{ source clothkit.planning.uncertainty.bounded_exp }}` is replaced by the current source of that function,
class or constant.
Equations between dollars become MathML, which browsers render without scripts. Every module of src/clothkit is listed
in the reference, and the figures are those of the laptop report.
"""

import ast
import functools
import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src"
FIGURES = ROOT / "reports/laptop/figures"

_INCLUDE = re.compile(r"^\{\{ source ([\w.]+) \}\}$", re.MULTILINE)
_EQUATION = re.compile(r'<(span|div) class="arithmatex">(?:\\\(|\\\[)(.*?)(?:\\\)|\\\])</\1>', re.DOTALL)
_TAG = re.compile(r"\\tag\{(\w+)\}")


def on_config(config: Any) -> Any:
    """Add the reference's pages as the last entry of the navigation."""
    pages = [{name: path} for name, path, _ in reference_pages()]
    config.nav.append({"Reference": pages})
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the reference's pages and the laptop report's figures."""
    for _, path, text in reference_pages():
        files.append(File.generated(config, path, content=text))
    for picture in sorted(FIGURES.glob("*.png")):
        files.append(File.generated(config, f"figures/{picture.name}", abs_src_path=str(picture)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return the page with its `{{ source ... }}` lines replaced by the sources."""
    return _INCLUDE.sub(lambda found: included(found[1]), markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Return the page with its equations as MathML."""
    return _EQUATION.sub(lambda found: equation(html.unescape(found[2]), block=found[1] == "div"), content)


@functools.cache
def reference_pages() -> list[tuple[str, str, str]]:
    """Return (name, path, Markdown) of a page for the top-level modules and of one for each package of clothkit."""
    top = SOURCE / "clothkit"
    folders = [top, *sorted(folder for folder in top.iterdir() if (folder / "__init__.py").exists())]
    return [_reference_page(folder, folder == top) for folder in folders]


def _reference_page(folder: Path, flat: bool) -> tuple[str, str, str]:
    files = sorted(folder.glob("*.py") if flat else folder.rglob("*.py"))
    modules = [file for file in files if not file.name.startswith("__")]
    if flat:
        about = "Settings, errors, and what stage scripts share."
    else:
        about = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
    lines = [f"# clothkit.{folder.name}" if not flat else "# clothkit", "", about, ""]
    lines += [*(_tree() if flat else _listed(modules)), ""]
    for file in modules:
        lines += [f"::: {name_of(file)}", ""]
    return folder.name, f"reference/{folder.name if not flat else 'index'}.md", "\n".join(lines)


def _tree() -> list[str]:
    """Return a table of all packages with their summaries, as lines of Markdown."""
    folders = sorted(init.parent for init in (SOURCE / "clothkit").glob("*/__init__.py"))
    rows = [f"| [clothkit.{folder.name}]({folder.name}.md) | {summary(folder / '__init__.py')} |" for folder in folders]
    return ["| package | |", "|---|---|", *rows]


def _listed(modules: list[Path]) -> list[str]:
    """Return a table of a package's modules with their summaries, as lines of Markdown."""
    rows = [f"| [{name_of(file)}][{name_of(file)}] | {summary(file)} |" for file in modules]
    return ["| module | |", "|---|---|", *rows]


def summary(file: Path) -> str:
    """Return the first paragraph of a module's docstring as a table cell, empty if there is none."""
    text = ast.get_docstring(ast.parse(file.read_text())) or ""
    return " ".join(text.split("\n\n")[0].split()).replace("|", "\\|")


def name_of(file: Path) -> str:
    """Return the module name of a source file."""
    return ".".join(file.relative_to(SOURCE).with_suffix("").parts)


def included(name: str) -> str:
    """Return the source of the named object as a code block with a link to the reference."""
    file, first, code = find_source(name)
    place = f"{file.relative_to(ROOT)}, line {first}"
    link = "" if ".__" in name or "._" in name else f"\n[`{name}`][{name}]{{ .source }}\n"
    return f'```python title="{place}"\n{code}\n```\n{link}'


def find_source(name: str) -> tuple[Path, int, str]:
    """Return the file, first line and text of a function, class, method or constant.

    Raises LookupError if there is none of that name.
    """
    parts = name.split(".")
    for count in range(len(parts) - 1, 0, -1):
        file = SOURCE.joinpath(*parts[:count]).with_suffix(".py")
        if file.is_file():
            break
    else:
        raise LookupError(f"{name}: no such module")
    text = file.read_text()
    body = ast.parse(text).body
    for part in parts[count:]:
        found = [(i, node) for i, node in enumerate(body) if part in _names(node)]
        if not found:
            raise LookupError(f"{name}: not in {file}")
        position, node = found[0]
        last = node.end_lineno
        # A constant's docstring is the string below it, which is included.
        after = body[position + 1] if position + 1 < len(body) else None
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(after, ast.Expr):
            last = after.end_lineno
        first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])
        body = getattr(node, "body", [])
    lines = text.splitlines()[first - 1 : last]
    indent = len(lines[0]) - len(lines[0].lstrip())
    return file, first, "\n".join(line[indent:] for line in lines)


def _names(node: ast.stmt) -> list[str]:
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    return [target.id for target in targets if isinstance(target, ast.Name)]


def equation(tex: str, *, block: bool) -> str:
    """Return an equation as MathML, with its number at the right if it has a tag."""
    tag = _TAG.search(tex)
    drawn = convert(_TAG.sub("", tex).strip(), display="block" if block else "inline")
    if not block:
        return drawn
    number = f'<span class="number">({tag[1]})</span>' if tag else ""
    return f'<div class="equation">{drawn}{number}</div>'

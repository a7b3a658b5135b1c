"""What the documentation says is true: its Python and its commands are run, page by page, on small data.

What takes too long says so before its block (`<!-- no-run: why -->`). Of that it is checked that programs, options,
stages, settings and files are there. Sources and the reference are taken from the tree when the site is built.
"""

import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pandas as pd
import pytest
from click.testing import CliRunner

from clothkit.app.cli import COMMANDS, cli
from clothkit.planning.systems import SYSTEMS
from clothkit.simulation.material import FABRICS
from clothkit.simulation.records import SCHEMAS
from tests.documents import PIPELINE, Block, blocks, check, check_settings, commands, indented
from tests.tiny import ROOT, write_data, write_params

PAGES = sorted((ROOT / "docs").glob("*.md"))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Params and data as the repository's root has them, but small."""
    folder = tmp_path_factory.mktemp("root")
    write_params(folder / "params.yaml")
    write_data(folder / "data", folder / "params.yaml")
    return folder


@pytest.fixture
def here(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A current directory that a page may fill. What a page adds to the library is forgotten after it."""
    for name in ("params.yaml", "data"):
        (tmp_path / name).symlink_to(root / name)
    (tmp_path / "reports").symlink_to(ROOT / "reports")
    monkeypatch.chdir(tmp_path)
    registries: list[dict[str, Any]] = [FABRICS, SYSTEMS]
    kept = [registry.copy() for registry in registries]
    yield tmp_path
    for registry, before in zip(registries, kept, strict=True):
        registry.clear()
        registry.update(before)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_block_of_a_page_runs(
    page: Path, here: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In order, and in one namespace: a page tells one story."""
    scratch = tmp_path_factory.mktemp("scratch")
    module = ModuleType(f"page_{page.stem.replace('-', '_')}")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    for block in blocks(page):
        if block.language == "python":
            assert block.why_not is None, f"{page.name}, line {block.line}: Python is run, always"
            # Lines keep their numbers, for what tracebacks say.
            exec(compile("\n" * (block.line - 1) + block.code, str(page), "exec"), vars(module))
        elif block.language == "sh":
            run_or_check(block, scratch)
        elif block.language == "yaml":
            check_settings(block.code, block.title, scratch)
        else:
            raise AssertionError(f"{page.name}, line {block.line}: nothing runs {block.language}")


def run_or_check(block: Block, scratch: Path) -> None:
    """Commands of clothkit are run here; others only in a block that says why they are not."""
    for words in commands(block.code):
        check(words, scratch)
        if block.why_not:
            continue
        assert words[:2] == ["./run", "clothkit"], f"{block.page.name}, line {block.line}: expected a reason"
        result = CliRunner().invoke(cli, words[2:])
        assert result.exit_code == 0, f"{' '.join(words)}: {result.output}{result.exception!r}"


def test_readme_names_what_there_is(tmp_path: Path) -> None:
    readme = ROOT / "README.md"
    lines = [line for line in indented(readme) if re.match(r"(\./run|[A-Z]+=|git) ?", line)]
    spans = re.findall(r"`((?:LOCK=\S+ )?\./run [^`]+|git checkout [^`]+)`", readme.read_text())
    # Words in capitals stand for something.
    told = [span for span in spans if not re.search(r"\b[A-Z]{3,}\b", span.replace("LOCK=", ""))]
    assert len(lines) > 20
    for line in [*lines, *told]:
        for words in commands(line):
            check(words, tmp_path)


def test_readme_shows_where_everything_is() -> None:
    """The list of files has every package, and nothing that isn't there."""
    listing = (ROOT / "README.md").read_text().split("## Where things are")[1]
    above: dict[int, Path] = {}
    listed = set()
    for line in listing.splitlines():
        indent = len(line) - len(line.lstrip())
        if not 4 <= indent <= 12:
            continue
        name = line.split()[0].rstrip(",")
        folder = next((above[i] for i in sorted(above, reverse=True) if i < indent), ROOT)
        above = {i: path for i, path in above.items() if i < indent}
        if name.endswith("/"):
            above[indent] = folder / name
        assert (folder / name).exists(), f"README.md lists {folder / name}"
        listed |= {folder / name, *(folder / other for other in re.findall(r"\b\w+\.py\b", line))}
    packages = {init.parent for init in (ROOT / "src/clothkit").glob("*/__init__.py")}
    assert packages <= listed


def test_nothing_is_forgotten() -> None:
    """Every command, stage and system, and every column of the raw artifacts, is told of."""
    texts = {page.stem: page.read_text() for page in PAGES}
    for name in COMMANDS:
        assert f"`clothkit {name}`" in texts["your-own-cloth"]
    for name, definition in PIPELINE.items():
        assert f"`{name}" in texts["index"], name
        for variant in definition.get("foreach", ()):
            assert f"@{variant}`" in texts["index"], f"{name}@{variant}"
    columns = {column for schema in SCHEMAS.values() for column in schema.names}
    assert not {column for column in columns if f"`{column}`" not in texts["data-formats"]}


def test_the_columns_of_tidy_rows_are_those_that_are_told(root: Path) -> None:
    told = (ROOT / "docs/data-formats.md").read_text()
    for file, name in (
        ("estimation", "estimation"),
        ("prediction", "prediction"),
        ("planning/main", "planning/SYSTEM"),
    ):
        row = next(line for line in told.splitlines() if line.startswith(f"| `{name}.parquet`"))
        columns = set(re.findall(r"`(\w+)`", row.split("|")[3]))
        assert columns == set(pd.read_parquet(root / f"data/evaluation/{file}.parquet").columns)


def hooks() -> ModuleType:
    """What builds the site."""
    spec = importlib.util.spec_from_file_location("docs_hooks", ROOT / "docs/hooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_equation_has_the_code_that_implements_it_below() -> None:
    site, text = hooks(), (ROOT / "docs/how-it-works.md").read_text()
    parts = re.split(r"^#{2,3} ", text, flags=re.MULTILINE)
    for number in range(1, 17):
        part = next(part for part in parts if part.startswith(f"Eq. ({number}): "))
        assert f"{{ #eq-{number} }}" in part
        assert f"\\tag{{{number}}}" in part
        assert "{{ source " in part
    shown = site.on_page_markdown(text)
    assert "{{" not in shown.replace("^{{", "")
    assert "def bounded_exp" in shown
    with pytest.raises(LookupError, match="no_such"):
        site.find_source("clothkit.planning.loss.no_such")


def test_equations_become_mathml() -> None:
    drawn = hooks().on_page_content(r'<div class="arithmatex">\[a &lt; b \tag{3}\]</div>')
    assert "<math" in drawn
    assert '<span class="number">(3)</span>' in drawn
    assert "&#x0003C;" in drawn or "&lt;" in drawn

"""What the documentation says is true: its Python and its commands are run, page by page, on small data.

What takes too long says so before its block (`<!-- no-run: why -->`). Of that it is checked that programs, options,
stages, settings and files are there. What needs an optional library (`<!-- needs: gymnasium -->`) is run where that is
installed. Sources and the reference are taken from the tree when the site is built.
"""

import importlib.util
import json
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
from clothkit.planning.optimisers import OPTIMISERS
from clothkit.planning.systems import SYSTEMS
from clothkit.simulation.material import FABRICS
from clothkit.simulation.records import SCHEMAS
from tests.documents import PIPELINE, Block, blocks, check, check_settings, commands, indented, variants
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
    monkeypatch.setenv("HF_DATASETS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("clothkit.app.named_goals.user_folder", lambda: root / "goals")
    if importlib.util.find_spec("gymnasium") is not None:
        monkeypatch.setattr("clothkit.environment.fold.user_folder", lambda: root / "goals")
    registries: list[dict[str, Any]] = [FABRICS, OPTIMISERS, SYSTEMS]
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
        if block.needs is not None and importlib.util.find_spec(block.needs) is None:
            continue
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
    assert len(lines) > 14
    for line in [*lines, *told]:
        for words in commands(line):
            check(words, tmp_path)


def test_readme_is_short_and_its_figures_are_the_report_s() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 130
    table_6, table_3 = (pd.read_csv(ROOT / f"reports/laptop/tables/table_{n}.csv") for n in (6, 3))
    columns = ["1/all", "2/all", "3/all"]

    def of(table: pd.DataFrame, system: str, source: str = "clothkit", statistic: str = "mean") -> str:
        found = table[(table["split"] == "test") & (table["system"] == system) & (table["source"] == source)]
        (row,) = found.loc[found["statistic"] == statistic, columns].to_numpy()
        return ", ".join(f"{value:#.3g}" for value in row)

    rows = dict(re.findall(r"^\| ([a-z][^|]+) \| (0\.\d+ \| 0\.\d+ \| 0\.\d+) \|$", text, re.MULTILINE))
    told = {name: figures.replace(" | ", ", ") for name, figures in rows.items()}
    assert told == {
        "outcome of plans, best of the cloth's eight labellings": of(table_6, "main"),
        "outcome of plans, as labelled": of(table_6, "main", statistic="mean, labelled"),
        "outcome of plans, the paper's": of(table_6, "main", source="paper"),
        "prediction": of(table_3, "main"),
        "prediction, the paper's": of(table_3, "main", source="paper"),
    }
    for system in ("b1", "b2", "b3"):
        assert of(table_6, system) in " ".join(text.split())
    household = pd.read_csv(ROOT / "reports/household/tables/table_6.csv")
    for system in ("main", "b1", "b3"):
        assert of(household, system) in " ".join(text.split())
    study = pd.read_csv(ROOT / "reports/laptop/studies/doubt_test_comparisons.csv").set_index(["system", "against"])
    for against, words in (
        ("b3", "distance alone, by {}, {}, {} for one"),
        ("eq13", "eq. (13) alone by {}, {}, {} (p"),
    ):
        rows = study.loc[("main", against)].set_index("column").loc[columns]
        assert words.format(*(f"{-value:.3f}" for value in rows["difference"])) in " ".join(text.split())
    assert (rows["p"] < 0.001).all()
    without = study.loc[("main", "b3")].set_index("column").loc[columns, "p"]
    assert f"(p {without.iloc[0]:.2f}, {without.iloc[1]:.3f}, < 0.001)" in " ".join(text.split())
    assert without.iloc[2] < 0.001
    one_net = study.loc[("main", "b2")].set_index("column").loc[columns]
    by = ", ".join(f"{-value:.3f}" for value in one_net["difference"])
    assert f"of one net, by {by} (p {one_net['p'].iloc[0]:.2f}, < 0.001 twice)" in " ".join(text.split())
    assert (one_net["p"].iloc[1:] < 0.001).all()
    pairs = pd.read_csv(ROOT / "reports/laptop/tables/planning_comparisons.csv")
    pairs = pairs[(pairs["split"] == "test") & (pairs["measure"] == "error") & (pairs["system"] == "main")]
    with_one_net = pairs[(pairs["against"] == "b2") & (pairs["column"] == "3/all")].iloc[0]
    assert with_one_net["difference"] < 0
    assert f"p {with_one_net['p']:.3f})" in text


def test_what_is_said_of_the_bound_on_the_distance_is_the_study_s() -> None:
    text = (ROOT / "docs/how-it-works.md").read_text()
    rows = pd.read_csv(ROOT / "reports/laptop/studies/doubt_test.csv")
    own = rows[(rows["system"] == "main") & (rows["measure"] == "expected") & (rows["alpha"] == 1) & ~rows["fold"]]
    for length, some in own.groupby("length"):
        kept = f"{(some['error'] <= some['loss']).mean():.0%}".replace("%", " %")
        figures = f"{some['loss'].mean():#.3g} | {some['error'].mean():#.3g} | {kept}"
        assert f"| {length} | {len(some)} | {figures} |" in text
    powers = json.loads((ROOT / "prebuilt/household/normalisation/expected_error.json").read_text())["slope"]
    told = "{:.2f}, {:.2f} and {:.2f}".format(*powers)
    assert f"(the ready-made nets' are {told})" in " ".join(text.split())


def test_the_reference_tells_what_every_module_is_for() -> None:
    site = hooks()
    pages = {path: text for _, path, text in site.reference_pages()}
    for file in (ROOT / "src/clothkit").rglob("*.py"):
        if file.name.startswith("__"):
            continue
        place = file.relative_to(ROOT / "src/clothkit")
        page = pages[f"reference/{place.parts[0] if len(place.parts) > 1 else 'index'}.md"]
        assert f"::: {site.name_of(file)}\n" in page
        assert site.summary(file), f"{file}: has no docstring"
        if len(place.parts) > 1:
            assert f"| [{site.name_of(file)}][{site.name_of(file)}] | {site.summary(file)} |" in page
    assert site.summary(ROOT / "src/clothkit/planning/irprop.py").startswith("iRprop-")
    packages = {init.parent.name for init in (ROOT / "src/clothkit").glob("*/__init__.py")}
    assert all(f"[clothkit.{package}]({package}.md) | " in pages["reference/index.md"] for package in packages)


def test_every_deviation_names_the_code_that_does_it() -> None:
    site, text = hooks(), (ROOT / "docs/deviations.md").read_text()
    rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| the paper")]
    assert len(rows) > 20
    for row in rows:
        *_, where = (cell.strip() for cell in row.strip("|").split(" | "))
        name = re.fullmatch(r"`(clothkit[\w.]+)`", where)
        assert name, row
        site.find_source(name[1])
    for path in re.findall(r"`((?:studies|benchmarks|reports)/[\w/]+\.\w+)`", text):
        assert (ROOT / path).exists(), path


def test_nothing_is_forgotten() -> None:
    """Every command, stage and system, and every column of the raw artifacts, is told of."""
    texts = {page.stem: page.read_text() for page in PAGES}
    for name in COMMANDS:
        assert f"`clothkit {name}`" in texts["your-own-cloth"]
    for name, definition in PIPELINE.items():
        assert f"`{name}" in texts["index"], name
        for variant in variants(definition):
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
        site.find_source("clothkit.planning.uncertainty.no_such")


def test_equations_become_mathml() -> None:
    drawn = hooks().on_page_content(r'<div class="arithmatex">\[a &lt; b \tag{3}\]</div>')
    assert "<math" in drawn
    assert '<span class="number">(3)</span>' in drawn
    assert "&#x0003C;" in drawn or "&lt;" in drawn

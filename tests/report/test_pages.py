"""Pages from the tables that git holds: the committed ones byte for byte, older reports, damaged tables."""

import re
from pathlib import Path

import pandas as pd
import pytest
from ruamel.yaml import YAML

from clothkit.evaluation import comparisons
from clothkit.report import formatting, pages, sections, texts
from clothkit.report.blocks import Picture
from clothkit.report.entries import Figure, Report, Section, Table, Text
from clothkit.report.markdown.page import page
from clothkit.report.paper import without_paper
from clothkit.report.sections import CAPTIONS, DRAWN, TABLES
from clothkit.runtime.errors import InputError
from tests.evaluation.planning_rows import SYSTEMS
from tests.report.contents import contents_of, parts_of, tables_of, write_report
from tests.report.web import tree

REPORTS = Path(__file__).parents[2] / "reports"


@pytest.mark.parametrize("scale", ["household", "laptop", "overnight"])
def test_the_committed_pages_are_made_from_the_committed_tables(scale: str, tmp_path: Path) -> None:
    pages.write(REPORTS / scale, tmp_path)
    for name in pages.OUTS:
        made, committed = ((folder / name).read_bytes() for folder in (tmp_path, REPORTS / scale))
        assert made == committed, f"{name} is not what stages/pages.py makes of reports/{scale}: run it"


@pytest.mark.parametrize(
    "missing",
    [
        ("table_4_025", "table_7_025", "planned"),
        tuple({Path(path).stem for path in TABLES} - {"table_6"}),
        ("timings", "table_8"),
    ],
)
def test_what_an_older_report_lacks_is_not_missed(tmp_path: Path, missing: tuple[str, ...]) -> None:
    made = {name: table for name, table in tables_of(SYSTEMS).items() if name not in missing}
    text = page("Report: laptop", parts_of(pages.read(write_report(tmp_path / "report", made))))
    for name in missing:
        assert f"/{name}.csv" not in text
    assert "every task of" in text
    assert text.count("Not measured in this report.") == sum(
        name.startswith("table_") for name in missing if name != "table_8"
    )


def test_a_report_of_other_cloths_does_not_speak_of_the_papers_figures(tmp_path: Path) -> None:
    absent = ("table_4", "table_4_025", "table_7", "table_7_025")
    made = {name: without_paper(table) for name, table in tables_of(SYSTEMS).items() if name not in absent}
    folder = write_report(tmp_path / "report", made)
    settings = YAML(typ="safe").load(folder / "params.yaml")
    settings["scales"][settings["scale"]]["report"]["paper"] = False
    YAML().dump(settings, folder / "params.yaml")
    pages.write(folder, tmp_path)
    assert set(pd.read_csv(tmp_path / "budgets.csv")["source"]) == {"clothkit"}
    text = (tmp_path / "README.md").read_text()
    assert "| paper |" not in text
    assert "Not measured in this report." not in text
    for told in ("The paper's", "In the paper", "As in the paper", "The paper gives", "The paper does not say"):
        assert told not in text


@pytest.mark.parametrize("scale", ["household", "laptop"])
def test_the_introduction_names_the_systems_that_the_report_has_and_no_others(scale: str, tmp_path: Path) -> None:
    systems = ("main", "b1", "b3") if scale == "household" else SYSTEMS
    made = tables_of(systems)
    told = texts.intro(Report(contents_of(tmp_path / "report", systems), pd.DataFrame()))
    there = {system for name in ("table_3", "table_6") for system in made[name]["system"]}
    named = set(re.findall(r"\*(\w+)\*", told))
    assert named == there - {"no action", "unrefined"}


def test_a_section_is_left_out_where_a_report_lacks_its_data(tmp_path: Path) -> None:
    made = {"table_6": tables_of(SYSTEMS)["table_6"]}
    parts = parts_of(pages.read(write_report(tmp_path / "report", made, ["sequences"])))
    assert [section.id for section in parts] == [
        *("short", "planning", "prediction", "estimation", "data", "time", "params")
    ]
    text = page("Report: laptop", parts)
    # Of its parts those are left out that are not there: neither the dataset's tables nor the learning curves.
    (found,) = (section for section in parts if section.id == "data")
    assert [type(block) for block in found.blocks] == [Picture]
    assert "depth camera" not in text


def test_a_section_is_one_entry_for_both_renderers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_report(tmp_path / "report", tables_of(SYSTEMS))
    more = Section(
        "hands",
        "Hands",
        (
            Text(lambda report: f"{len(report.table('splits'))} splits.\n"),
            Table("splits", "Hands by split", ("split", "single_handed"), rows=lambda _, rows: rows[["split"]]),
            Figure("hands", "Hands", "Not drawn."),
        ),
    )
    monkeypatch.setattr(sections, "SECTIONS", (*sections.SECTIONS, more))
    pages.write(folder, tmp_path)
    text, markup = ((tmp_path / name).read_text() for name in ("README.md", "index.html"))
    assert "## Hands\n\n3 splits.\n\n### Hands by split\n\n[CSV](tables/splits.csv)\n\n| split |" in text
    (found,) = tree(markup).all("section", id="hands")
    assert [head.text for head in found.all("h3")] == ["Hands by split"]
    assert found.all("p")[0].text == "3 splits."
    assert tree(markup).all("a", href="#hands")
    assert "Not drawn" not in text + markup


def test_intervals_of_too_few_sequences_are_not_shown(tmp_path: Path) -> None:
    assert formatting.LEAST == comparisons.LEAST, "what evaluations leave out is called too few, and nothing else is"
    folder = write_report(tmp_path / "report", tables_of(SYSTEMS))
    few = pd.read_csv(folder / "tables/planned.csv").assign(sequences=[12, 9])
    few.to_csv(folder / "tables/planned.csv", index=False)
    compared = pd.read_csv(folder / "tables/planning_comparisons.csv")
    compared.loc[compared["column"] == "3/all", "sequences"] = 9
    compared.to_csv(folder / "tables/planning_comparisons.csv", index=False)
    shown = pages.read(folder)
    intervals = shown.tables["table_7"].query("statistic in ('mean 95 % low', 'mean 95 % high')")
    assert intervals.groupby("split")["1/0"].count().to_dict() == {"test": 12, "train": 0}
    assert shown.tables["table_7"].query("statistic == 'mean'").notna().all(axis=None)
    text = page("Report: laptop", parts_of(shown))
    assert "| train | b2 | mean 95 % high | clothkit |" + 8 * " too few |" in text
    (line,) = (line for line in text.splitlines() if line.startswith("| error | main | b1 | 3/all |"))
    assert line.endswith("| too few | too few | too few |")
    (line,) = (line for line in text.splitlines() if line.startswith("| error | main | b1 | 2/all |"))
    assert "too few" not in line
    # Three sequences before cameras.
    assert text.count("| too few | too few | too few |") >= 6


def test_reports_of_before_sequences_were_counted_tell_them_by_their_comparisons(tmp_path: Path) -> None:
    made = tables_of(SYSTEMS, sequences=11)
    del made["planned"]
    assert pages.read(write_report(tmp_path / "one", made)).planned == {"test": 11, "train": 11}
    del made["planning_comparisons"]
    # Then by their settings.
    assert pages.read(write_report(tmp_path / "two", made)).planned == {"test": 20, "train": 5}


def test_a_study_of_the_memory_trace_is_linked_where_there_is_one(tmp_path: Path) -> None:
    shown = contents_of(tmp_path / "report", SYSTEMS)
    assert "The effect was not measured for this report." in page("Report: laptop", parts_of(shown))
    rows = ("carried,1/1,40,0.0042,0.0001", "carried,2/1,38,-0.001,0.03", "none,1/1,,,", "frame,1/1,40,0.3,0.5")
    (tmp_path / "report/studies/memory.csv").write_text("\n".join(("system,column,sequences,difference,p", *rows)))
    told = page("Report: laptop", parts_of(pages.read(tmp_path / "report")))
    assert "[A study](studies/memory.csv) on 38 validation sequences" in told
    assert "changes by -0.0010 to +0.0042" in told
    assert "p at most 0.03)" in told


def test_studies_are_shown_where_a_report_has_their_tables(tmp_path: Path) -> None:
    named = {"Number of manipulations": "plan_length_summary", "Reach": "reach_summary"}
    folder = write_report(tmp_path / "report", tables_of(SYSTEMS), (), DRAWN)
    text = page("Report: laptop", parts_of(pages.read(folder)))
    for title, name in named.items():
        assert f"\n## {title}\n" in text
        assert f"[CSV](studies/{name}.csv)" in text
    assert [f"![{Path(path).stem}]({path})" in text for path in DRAWN] == [True] * 4
    # What was chosen against what was given: of the test set, by length and over all.
    lines = [line for line in text.splitlines() if line.startswith(("| main | given |", "| main | chosen |"))]
    assert len(lines) == 8
    (line,) = (line for line in lines if line.startswith("| main | chosen | 3/all |"))
    figures = "0.0500 | 0.0450 | 0.0550 | 3.25 | 0.300 | -0.0100 | -0.0120 | -0.00800 | 0.0300"
    assert line == f"| main | chosen | 3/all | 60 | {figures} |"
    assert "| 0.0150 | 120 | 0.0407 | 1.44 | 0.00 | 0.00 | yes |" in text
    assert "| validation | error | 2/all | 12 | 0.0310 | 0.0420 | 0.0110 |" in text
    assert "| square | 0.150 | turning | 180 | 0.250 | 0.0500 | 0.00 | 0.250 | 0.0500 | 0.0400 |" in text
    for path in (*DRAWN, *(f"studies/{name}.csv" for name in named.values())):
        assert path in pages.INPUTS
        (folder / path).unlink()
    text = page("Report: laptop", parts_of(pages.read(folder)))
    for told in (*(f"## {title}\n" for title in named), "What doubt is worth", "studies/"):
        assert told not in text.replace("[A study](studies/", "")


def test_whole_figures_stay_figures_and_counts_stay_counts(tmp_path: Path) -> None:
    made = tables_of(SYSTEMS)
    compared = made["planning_comparisons"].assign(difference=2.0)
    shown = pages.read(write_report(tmp_path / "report", {**made, "planning_comparisons": compared}))
    line = next(
        line for line in page("Report: laptop", parts_of(shown)).splitlines() if line.startswith("| error | main |")
    )
    assert "| 1/all | 12 | 2.00 |" in line


def test_pictures_keep_the_captions_that_they_were_drawn_with(tmp_path: Path) -> None:
    folder = write_report(tmp_path / "report", tables_of(SYSTEMS), ["curves"])
    assert pages.read(folder).figures == {"curves": CAPTIONS["curves"]}
    (folder / "figures/captions.json").write_text('{"curves": "As of *then*.", "scatter": "Not there."}')
    shown = pages.read(folder)
    assert "*As of *then*.*" in page("Report: laptop", parts_of(shown))
    assert shown.figures == {"curves": "As of *then*."}
    for text in ("{", "[]", "{}"):
        (folder / "figures/captions.json").write_text(text)
        with pytest.raises(InputError, match=r"captions\.json: expected a JSON object with a caption"):
            pages.read(folder)


def test_where_voxel_tables_stand_is_told_in_times_of_the_papers(tmp_path: Path) -> None:
    made = tables_of(SYSTEMS)
    table = made["table_7"].copy()
    own = (table["source"] == "clothkit") & (table["statistic"] == "mean") & (table["split"] == "test")
    # The paper's: 0.00561, 0.00907, 0.0119.
    table.loc[own & (table["system"] == "main"), ["1/all", "2/all", "3/all"]] = [0.01122, 0.01814, 0.02975]
    errors = made["table_6"].copy()
    errors.loc[own & (errors["system"] == "main"), ["1/all", "2/all", "3/all"]] = [0.0495, 0.04095, 0.109]
    shown = pages.read(write_report(tmp_path / "report", {**made, "table_7": table, "table_6": errors}))
    told = texts.viewport(shown, "table_7", "table_6")
    assert told.startswith(
        "Of our means by length, those of *main* are 2.00 to 2.50 times the paper's (0.50 to 1.00 times in table 6), "
    )
    # The example that the paper's tables give.
    assert "(0.0913 in its table 6, 0.0103 in its table 7)" in told
    assert "(0.0915 in its table 6, 0.0254 in its table 7)" in told


def test_bad_tables_are_named(tmp_path: Path) -> None:
    folder = write_report(tmp_path / "report", tables_of(("main",)))
    path = folder / "tables/table_5.csv"
    pd.read_csv(path).drop(columns="2").to_csv(path, index=False)
    with pytest.raises(InputError, match=r"table_5\.csv: expected the columns .*; 2 not found"):
        pages.read(folder)
    path.write_bytes(b"\xff\xfe,\n")
    with pytest.raises(InputError, match=r"table_5\.csv: expected a table as CSV"):
        pages.read(folder)
    (folder / "tables/table_6.csv").unlink()
    path.unlink()
    with pytest.raises(InputError, match=r"table_6\.csv: not found; run the stage"):
        pages.read(folder)

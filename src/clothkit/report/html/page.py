"""The page: its sections in order, and the template that holds them."""

from dataclasses import dataclass
from pathlib import Path
from string import Template

import pandas as pd

from clothkit.report import captions
from clothkit.report.html import costs, tables
from clothkit.report.html.elements import Html, element, inline, joined, paragraph
from clothkit.report.html.headline import headline
from clothkit.report.html.pictures import picture
from clothkit.report.page import BY_LENGTH, KEYS, Contents, short

HERE = Path(__file__).parent

SPLITS = {"test": "Test set", "train": "Training set"}

VOXELS = ("table_4", "table_7")
"""Tables of voxel differences."""

HEADS = {
    "table_2": {"1": "after 1", "2": "after 2", "3": "after 3"},
    "table_5": {"1": "1 manipulation", "2": "2 manipulations", "3": "3 manipulations"},
    "sigma_ratio": {"1": "prediction, 1", "2": "prediction, 2", "3": "prediction, 3"},
}


@dataclass(frozen=True)
class Run:
    """What is told of the run beside its results."""

    params: str
    """params.yaml, those that it was made with."""
    timings: pd.DataFrame
    table_8: pd.DataFrame


def page(contents: Contents, figures: Path, run: Run) -> str:
    """The page as one HTML document, its pictures from the folder `figures`.

    Equal contents give equal bytes, but for the section whose id is `costs.SECTION`.
    """
    sections = [
        ("planning", "Planning", _planning(contents, figures)),
        ("prediction", "Prediction", _prediction(contents, figures)),
        ("estimation", "Estimation", _estimation(contents, figures)),
        ("camera", "Depth camera", _camera(contents, figures)),
        ("uncertainty", "Uncertainty", _uncertainty(contents, figures)),
        ("data", "Data and training", _data(contents, figures)),
        (
            "representations",
            "Representations",
            _pictures(contents, figures, "meshes", "voxels", "trajectories", "equivalents"),
        ),
        (costs.SECTION, "Time", costs.costs(run.timings, run.table_8)),
        ("params", "Made with", _made_with(run.params)),
    ]
    top = [("short", "In short"), *((name, title) for name, title, _ in sections)]
    links = [element("li", element("a", title, href=f"#{name}")) for name, title in top]
    body = [_short(contents)]
    for name, title, content in sections:
        # Each on a line of its own, so that differences of two pages are told section by section.
        body.append(Html("\n" + element("section", element("h2", title), content, id=name)))
    return Template((HERE / "template.html").read_text()).substitute(
        title=f"Report: {contents.scale}",
        style=(HERE / "style.css").read_text(),
        links=element("ul", *links),
        body=joined(*body),
    )


def _short(contents: Contents) -> Html:
    counts = " and ".join(f"{count} {split}" for split, count in contents.tasks.items())
    return element(
        "section",
        element("h2", "In short"),
        paragraph("Test set, mean errors in lengths of the cloth's side: less is better."),
        headline(contents),
        tables.paired(short(contents), ("what", "system"), label="In short", judged=list(captions.SYSTEMS)),
        paragraph(captions.INTRO),
        *([paragraph(contents.canonical)] if contents.canonical else []),
        paragraph(f"Planned and executed: every task of {counts} sequences. {captions.PAPER}"),
        id="short",
    )


def _planning(contents: Contents, figures: Path) -> Html:
    compared = contents.planning_comparisons
    compared = compared[(compared["split"] == "test") & compared["column"].isin(BY_LENGTH)].drop(columns="split")
    failures = contents.failures[contents.failures["split"] == "test"].drop(columns="split")
    parts = [
        _pictures(contents, figures, "sessions_1", "sessions_2", "sessions_3"),
        _table(contents, "table_6", "Table 6: planning, in meshes", captions.LABELLED + captions.INTERVALS_BELOW),
        _pictures(contents, figures, "scatter"),
        _table(contents, "table_7", "Table 7: planning, in voxels", captions.PLANNING_VOXELS),
    ]
    if not compared.empty:
        parts.append(_plain("planning_comparisons", "Planners compared", compared, captions.PLANNING_COMPARISONS))
    parts += [
        _plain("failures", "Failures", failures, captions.FAILURES),
        _plain("largest", "Largest errors", contents.largest, captions.LARGEST),
        _pictures(contents, figures, "largest"),
    ]
    return joined(*parts)


def _prediction(contents: Contents, figures: Path) -> Html:
    return joined(
        _pictures(contents, figures, "predictions"),
        _table(contents, "table_3", "Table 3: predicted meshes"),
        _table(contents, "table_4", "Table 4: the same in voxels", captions.VOXELS),
        element("h3", "Predictors compared", id="comparisons"),
        paragraph(captions.COMPARISONS),
        tables.plain(contents.comparisons, label="Predictors compared"),
        _table(contents, "table_5", "Table 5: predicted position", captions.POSITION),
    )


def _estimation(contents: Contents, figures: Path) -> Html:
    return joined(
        _pictures(contents, figures, "estimates"),
        _table(contents, "table_2", "Table 2: estimated meshes", captions.STATES),
    )


def _camera(contents: Contents, figures: Path) -> Html:
    compared = element("h3", "Conditions compared", id="camera_comparisons")
    return joined(
        paragraph(captions.CAMERA),
        _plain("camera_estimation", "Seen and estimated", contents.camera_estimation, captions.CAMERA_ESTIMATION),
        _pictures(contents, figures, "camera"),
        _plain("camera_planning", "Planned", contents.camera_planning, captions.CAMERA_PLANNING),
        compared,
        paragraph(captions.CAMERA_COMPARISONS),
        tables.plain(contents.camera_comparisons, label="Conditions compared"),
    )


def _uncertainty(contents: Contents, figures: Path) -> Html:
    ratios = contents.sigma_ratio.drop(columns="system")
    ratios = ratios.assign(split=ratios["split"].map(SPLITS))
    return joined(
        element("h3", "Stated and actual"),
        paragraph(captions.UNCERTAINTY),
        _csv("sigma_ratio"),
        tables.paired(
            ratios,
            ("split",),
            label="Median sigma ratios",
            heads=HEADS["sigma_ratio"],
            judged=list(SPLITS.values()),
            ideal=tables.IDEAL_RATIO,
        ),
        _pictures(contents, figures, "calibration"),
    )


def _data(contents: Contents, figures: Path) -> Html:
    return joined(
        element("h3", "The dataset"),
        paragraph(_summary(contents)),
        _csv("splits"),
        tables.plain(contents.splits, label="Sequences by split"),
        element("h3", "Tried sequences"),
        paragraph("By what became of them."),
        _csv("attempts"),
        tables.plain(contents.attempts, label="Tried sequences"),
        _pictures(contents, figures, "sequences"),
        element("h3", "Training"),
        _pictures(contents, figures, "curves"),
    )


def _summary(contents: Contents) -> str:
    splits, attempts = contents.splits, contents.attempts
    count, manipulations = int(splits["sequences"].sum()), int(splits["manipulations"].sum())
    single = float((splits["single_handed"] * splits["manipulations"]).sum()) / max(manipulations, 1)
    accepted = float(attempts.loc[attempts["outcome"] == "accepted", "share"].sum())
    return (
        f"{count} sequences of a square cloth folded at random, {manipulations} manipulations, {100 * single:.1f} % of "
        f"them single-handed; {100 * accepted:.1f} % of the tried sequences were accepted. [The dataset's card]"
        "(dataset/README.md) tells its files, columns, quality and worst states."
    )


def _made_with(params: str) -> Html:
    return joined(
        paragraph("[params.yaml](params.yaml), [metrics.json](metrics.json), [the same as Markdown](README.md)."),
        element("details", element("summary", "The params"), element("pre", element("code", params), tabindex=0)),
    )


def _pictures(contents: Contents, figures: Path, *names: str) -> Html:
    return joined(*(picture(name, figures / f"{name}.png") for name in names if name in contents.figures))


def _csv(name: str) -> Html:
    return element("p", inline(f"[CSV](tables/{name}.csv)"))


def _plain(name: str, title: str, data: pd.DataFrame, text: str) -> Html:
    return joined(element("h3", title, id=name), paragraph(text), _csv(name), tables.plain(data, label=title))


def _table(contents: Contents, name: str, title: str, text: str = "") -> Html:
    """A table of the paper's: the test set, and below it, folded away, the training set."""
    data, keys = getattr(contents, name), KEYS[name][1:]
    unit = "mean voxel value difference" if name in VOXELS else "lengths of the cloth's side"
    parts = [element("h3", title, id=name), *([paragraph(text)] if text else []), _csv(name)]
    for split, words in SPLITS.items():
        rows = data[data["split"] == split].drop(columns="split")
        if rows.empty:
            continue
        table = tables.paired(rows, keys, label=f"{title}, {words.lower()}", heads=HEADS.get(name), unit=unit)
        parts += [element("h4", words), table] if split == "test" else [_folded(words, table)]
    return joined(*parts)


def _folded(title: str, content: Html) -> Html:
    return element("details", element("summary", title), content)

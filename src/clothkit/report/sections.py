"""The list of the report's sections, which both renderers show. To add a section, add an entry to SECTIONS.

A section has a title and its parts in order: texts, figures with their captions, tables with the columns that their
CSVs must have. A text is a string or a function of the report's data. A part is left out where a report lacks its data.
"""

from collections.abc import Mapping

import pandas as pd

from clothkit.report import blocks, captions, selections, texts
from clothkit.report.contents import Contents
from clothkit.report.entries import Figure, Folded, Report, Section, Table, Text, Timings
from clothkit.report.formatting import IDEAL_RATIO
from clothkit.report.in_short import IN_SHORT
from clothkit.report.layout import (
    BY_CLOTH,
    CLOTH_LENGTHS,
    COMPARISONS,
    HYPOTHESES,
    LENGTHS,
    OUTCOMES,
    PROBED,
    SPLITS,
    STATES,
    TRUST,
    VOXEL_DIFFERENCE,
)
from clothkit.report.planning_sections import (
    BY_SYSTEM,
    CAMERA,
    LENGTHS_OF_PLANS,
    NAMED_GOALS,
    SESSIONS,
    WITHIN_REACH,
)

SECTIONS = (
    IN_SHORT,
    SESSIONS,
    Section(
        "prediction",
        "Prediction",
        (
            Figure("predictions", "Figure 10", captions.PREDICTIONS),
            Table(
                "table_3",
                "Table 3: predicted meshes",
                OUTCOMES,
                rows=selections.mark_systems,
                keys=BY_SYSTEM,
                unit=CLOTH_LENGTHS,
                noted=True,
            ),
            Table(
                "table_4",
                "Table 4: predicted meshes, in voxels",
                OUTCOMES,
                (captions.VOXELS, texts.viewport_of_prediction, texts.unequal_training),
                selections.mark_systems,
                keys=BY_SYSTEM,
                unit=VOXEL_DIFFERENCE,
                noted=texts.is_beside_paper,
            ),
            Table(
                "table_4_025",
                "Table 4 for a viewport of height 0.25",
                OUTCOMES,
                (texts.with_paper(captions.TALL, captions.TALL_PAPER), captions.TALL_A2, texts.unequal_training),
                selections.mark_systems,
                keys=BY_SYSTEM,
                unit=VOXEL_DIFFERENCE,
                noted=texts.is_beside_paper,
            ),
            Table(
                "comparisons",
                "Predictors compared",
                COMPARISONS,
                (captions.COMPARISONS, texts.unequal_training),
                selections.comparisons,
            ),
            Table(
                "table_5",
                "Table 5: predicted position",
                ("source", "split", "system", "statistic", *LENGTHS),
                (captions.POSITION,),
                selections.mark_systems,
                keys=BY_SYSTEM,
                unit=CLOTH_LENGTHS,
                heads={"1": "1 manipulation", "2": "2 manipulations", "3": "3 manipulations"},
                noted=True,
            ),
        ),
    ),
    Section(
        "estimation",
        "Estimation",
        (
            Figure("estimates", "Figure 9", captions.ESTIMATES),
            Table(
                "table_2",
                "Table 2: estimated meshes",
                ("source", "split", "kind", "statistic", *STATES),
                (captions.STATES,),
                keys=("split", "kind", "statistic"),
                unit=CLOTH_LENGTHS,
                heads={"1": "after 1", "2": "after 2", "3": "after 3"},
                noted=True,
            ),
            Table(
                "hypotheses",
                "Several hypotheses",
                HYPOTHESES,
                (captions.HYPOTHESES,),
                unit=CLOTH_LENGTHS,
            ),
        ),
    ),
    CAMERA,
    Section(
        "doubt",
        "Doubt",
        (
            Text(captions.DOUBT),
            Figure("doubt", "What tells the errors of predictions", captions.DOUBT_MEASURES),
            Table(
                "doubt",
                "What tells the errors of predictions",
                ("statistic", "measure", *PROBED),
                (captions.DOUBT_TABLE,),
            ),
            Figure("trust", "Expected and real errors", captions.TRUST_PICTURED),
            Table("trust", "How far expectations came true", TRUST, (captions.TRUST,)),
        ),
        needs=("doubt", "trust"),
    ),
    Section(
        "doubt_studies",
        "What doubt is worth",
        (
            Figure("doubt_test", "Planning by what is minimised", captions.DOUBT_TEST, file="studies/doubt_test.png"),
            Figure("doubt_amount", "Doubt by data and nets", captions.DOUBT_AMOUNT, file="studies/doubt_amount.png"),
        ),
    ),
    NAMED_GOALS,
    LENGTHS_OF_PLANS,
    WITHIN_REACH,
    Section(
        "cloths",
        "Cloths",
        (
            Table(
                "by_cloth",
                "Errors by cloth",
                BY_CLOTH,
                (captions.BY_CLOTH,),
                unit=CLOTH_LENGTHS,
            ),
        ),
        needs=("by_cloth",),
    ),
    Section(
        "uncertainty",
        "Uncertainty",
        (
            Table(
                "sigma_ratio",
                "Stated and actual uncertainty",
                ("source", "split", "system", "estimate", *LENGTHS),
                (texts.with_paper(captions.UNCERTAINTY, captions.UNCERTAINTY_PAPER), texts.estimates_by_state),
                selections.sigma_ratios,
                keys=("split",),
                judged=list(SPLITS.values()),
                ideal=IDEAL_RATIO,
                heads={"1": "prediction, 1", "2": "prediction, 2", "3": "prediction, 3"},
            ),
            Figure("calibration", "Calibration", captions.CALIBRATION),
        ),
    ),
    Section(
        "data",
        "Data and training",
        (
            Table(
                "splits",
                "The dataset",
                ("split", "sequences", "manipulations", "single_handed"),
                (texts.dataset,),
                needs=("attempts",),
            ),
            Table(
                "attempts",
                "Tried sequences",
                ("outcome", "attempts", "share"),
                (captions.ATTEMPTS,),
                needs=("splits",),
            ),
            Figure("sequences", "Simulated sequences", captions.SEQUENCES),
            Figure("curves", "Learning curves", captions.CURVES),
        ),
    ),
    Section(
        "representations",
        "Representations",
        (
            Figure("meshes", "Figures 2 and 3", captions.MESHES),
            Figure("voxels", "Figure 4", captions.VOXELS_PICTURED),
            Figure("trajectories", "Figure 5", captions.TRAJECTORIES),
            Figure("equivalents", "Figure 7", captions.EQUIVALENTS),
        ),
    ),
    Section(
        "time",
        "Time",
        (
            Table(
                "table_8",
                "Table 8: seconds per plan",
                ("source", "system", "machine", *LENGTHS, "estimate"),
                (texts.with_paper(captions.SPEED, captions.SPEED_PAPER),),
                selections.speed,
                file="table_8.csv",
            ),
            Timings(
                "timings",
                "Time per stage",
                ("stage", "seconds", "cpu_seconds", "peak_memory_mib", "machine"),
                captions.TIMINGS,
            ),
            Text(captions.STAGES, only="markdown"),
        ),
    ),
    Section(
        "params",
        "Settings",
        (
            Text("[params.yaml](params.yaml), [metrics.json](metrics.json).\n", only="markdown"),
            Text(
                "[params.yaml](params.yaml), [metrics.json](metrics.json), [the same as Markdown](README.md).",
                only="html",
            ),
            Folded("params.yaml", lambda report: report.contents.settings.text),
        ),
    ),
)
"""The sections in the order of the pages. On the Markdown page the first one follows the title without its own."""

TABLES: Mapping[str, tuple[str, ...]] = {
    entry.csv: entry.columns
    for section in SECTIONS
    for entry in section.entries
    if isinstance(entry, Table | Timings) and entry.columns
}
"""Paths of the sections' tables in a report's folder, and the columns that each must have."""

_FIGURES = [entry for section in SECTIONS for entry in section.entries if isinstance(entry, Figure)]

CAPTIONS: Mapping[str, str] = {figure.name: figure.caption for figure in _FIGURES if not figure.file}
"""Captions of all figures of the report stage, by name."""

DRAWN = tuple(figure.file for figure in _FIGURES if figure.file)
"""Paths of the studies' figures in a report's folder."""


def sections(contents: Contents, budgets: pd.DataFrame) -> list[blocks.Section]:
    """The sections with the data of a report, without those that it lacks.

    `budgets` is the table of `budgets.budgets`.
    """
    report = Report(contents, budgets)
    found = (section.resolve(report) for section in SECTIONS)
    return [section for section in found if section is not None]

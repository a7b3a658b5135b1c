"""The first section of a report: findings, the most important figures, and how to read them."""

from clothkit.report import captions, selections, texts
from clothkit.report.entries import Card, Cards, Section, Table, Text
from clothkit.report.layout import CLOTH_LENGTHS

IN_SHORT = Section(
    "short",
    "In short",
    (
        Text(texts.findings_on_planners),
        Text(texts.planned),
        Cards(
            (
                Card(
                    "Estimation",
                    "table_2",
                    "kind",
                    "dmr",
                    "all",
                    "Mean error of meshes estimated from voxels",
                ),
                Card(
                    "Prediction",
                    "table_3",
                    "system",
                    "main",
                    "3/all",
                    "Mean error of states predicted after three manipulations",
                ),
                Card(
                    "Planning, one step",
                    "table_6",
                    "system",
                    "main",
                    "1/all",
                    "Mean distance of the cloth from its goal after a one-step plan",
                ),
                Card(
                    "Planning, three steps",
                    "table_6",
                    "system",
                    "main",
                    "3/all",
                    "Mean distance of the cloth from its goal after a three-step plan",
                ),
            )
        ),
        Table(
            "means",
            "Mean errors on the test set",
            words=(
                texts.with_paper(captions.LABELLED_SHORT, captions.LABELLED_SHORT_PAPER),
                texts.replay,
                texts.unequal_budgets,
            ),
            rows=selections.means,
            keys=("what", "system"),
            judged=selections.systems_of_means,
            unit=CLOTH_LENGTHS,
            file="tables/table_6.csv",
        ),
        Text(texts.intro),
        Text(texts.descriptions),
    ),
)

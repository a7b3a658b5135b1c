"""What the run cost: the one part of the page that is not the same when the same run is done again."""

import pandas as pd

from clothkit.report import captions
from clothkit.report.html import tables
from clothkit.report.html.elements import Html, element, inline, joined, paragraph
from clothkit.report.timings import training

SECTION = "time"
"""The id of the section; whoever compares pages leaves it out."""


def costs(timings: pd.DataFrame, table_8: pd.DataFrame) -> Html:
    """Table 8, and a bar for the seconds of each stage."""
    told_of_training = training(timings)
    told = table_8.rename(columns={"1": "1 step", "2": "2 steps", "3": "3 steps", "estimate": "an estimate"})
    parts = [
        element("h3", "Table 8: seconds per plan"),
        paragraph(captions.SPEED_MEANS),
        element("p", inline("[CSV](table_8.csv)")),
        tables.plain(told[["system", "source", *told.columns[2:]]].fillna({"machine": ""}), label="Table 8"),
        element("h3", "Time per stage"),
        *([paragraph(told_of_training)] if told_of_training else []),
        paragraph(captions.TIMINGS),
        element("p", inline("[CSV](timings.csv)")),
        _stages(timings),
    ]
    return joined(*parts)


def _stages(timings: pd.DataFrame) -> Html:
    if timings.empty:
        return element("p", "No stage has left a note.")
    names = ("stage", "time", "share of the longest", "CPU time", "memory", "machine")
    # Bars and machines start at the left of their columns.
    heads = [
        element("th", name, scope="col", class_="word" if place in (2, 5) else None) for place, name in enumerate(names)
    ]
    longest = max(float(timings["seconds"].max()), 1e-9)
    lines = []
    for row in timings.to_dict("records"):
        bar = element("div", class_="bar", style=f"width:{100 * row['seconds'] / longest:.1f}%")
        lines.append(
            element(
                "tr",
                element("th", row["stage"], scope="row"),
                element("td", _clock(row["seconds"])),
                element("td", bar, class_="bars", aria_hidden="true"),
                element("td", _clock(row["cpu_seconds"])),
                element("td", f"{row['peak_memory_mib']} MiB"),
                element("td", str(row["machine"]), class_="word"),
            )
        )
    table = element("table", element("thead", element("tr", *heads)), element("tbody", *lines), class_="plain")
    return element("div", table, class_="scroll", tabindex=0, role="region", aria_label="Time per stage")


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{seconds:.1f} s"

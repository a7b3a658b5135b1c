"""The table of every stage's time and memory as HTML, with a bar for its seconds."""

import pandas as pd

from clothkit.report.blocks import Timings
from clothkit.report.html.elements import Html, element, inline, joined, paragraph


def timings(block: Timings) -> Html:
    """The seconds, the memory and the machine of each stage that recorded them."""
    return joined(
        element("h3", block.title),
        paragraph(block.paragraph),
        element("p", inline(f"[CSV]({block.csv})")),
        _stages(block.data, block.title),
    )


def _stages(timings: pd.DataFrame, label: str) -> Html:
    if timings.empty:
        return element("p", "No stage has recorded its time.")
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
    return element("div", table, class_="scroll", tabindex=0, role="region", aria_label=label)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{seconds:.1f} s"

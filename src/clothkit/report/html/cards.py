"""A card: one of the most important figures in large print, with the paper's figure and a sentence on its meaning."""

import math

from clothkit.report.blocks import Card
from clothkit.report.formatting import better, number
from clothkit.report.html.elements import Html, element


def card(shown: Card) -> Html:
    """The card as an element; its colour tells which figure is better."""
    best = better(shown.own, shown.paper)
    if best == "clothkit":
        comparison = "better than the paper's (in another simulator):"
    elif best == "paper":
        comparison = "the paper's (in another simulator) is better:"
    else:
        comparison = "the paper's (in another simulator):"
    text = f"{shown.meaning}; without any action {number(shown.no_action)}."
    labelled = [element("p", f"as labelled: {number(shown.labelled)}", class_="against")]
    return element(
        "div",
        element("p", shown.title, class_="title"),
        element("p", number(shown.own), class_="big"),
        *([] if math.isnan(shown.labelled) else labelled),
        element("p", f"{comparison} ", element("b", number(shown.paper)), class_="against"),
        element("p", text, class_="meaning"),
        class_={"clothkit": "card won", "paper": "card lost"}.get(best or "", "card"),
    )

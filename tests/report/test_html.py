"""The HTML page: complete, self-contained, well-formed, accessible; and the better figure is the one that is marked."""

import base64
import math
import re
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from clothkit.report.formatting import better
from clothkit.report.html import tables
from clothkit.report.html.elements import element, inline, unmarked
from clothkit.report.sections import CAPTIONS, DRAWN
from tests.report.contents import LAPTOP
from tests.report.web import Node, made_up_page, tree


@pytest.fixture(scope="module")
def markup(tmp_path_factory: pytest.TempPathFactory) -> str:
    return made_up_page(tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="module")
def document(markup: str) -> Node:
    return tree(markup)


def test_every_table_and_figure_is_there(document: Node) -> None:
    titles = [title.text for title in document.all("h3")]
    for number in range(2, 8):
        assert [title for title in titles if title.startswith(f"Table {number}: ")]
        assert document.all("a", href=f"tables/table_{number}.csv")
    for number in (4, 7):
        assert f"Table {number} for a viewport of height 0.25" in titles
        assert document.all("a", href=f"tables/table_{number}_025.csv")
    assert document.all("h3", id="budgets")
    assert document.all("a", href="budgets.csv")
    for name in ("comparisons", "planning_comparisons", "failures", "largest", "sigma_ratio", "splits", "attempts"):
        assert document.all("a", href=f"tables/{name}.csv")
    for path in DRAWN:
        (figure,) = document.all("figure", id=f"figure-{Path(path).stem}")
        assert figure.all("a", href=path)
    for name in CAPTIONS:
        (figure,) = document.all("figure", id=f"figure-{name}")
        (image,) = figure.all("img")
        assert image.attributes["alt"] == unmarked(CAPTIONS[name])
    # The training set lies folded away below the test set.
    assert len([title for title in document.all("summary") if title.text == "Training set"]) == 8
    (time,) = document.all("section", id="time")
    assert "Table 8" in time.text
    assert "4.76" in time.text
    assert "plan@main" in time.text
    (params,) = document.all("pre")
    assert params.text == (LAPTOP / "params.yaml").read_text()


def test_nothing_comes_from_elsewhere(markup: str, document: Node) -> None:
    assert not re.search(r"(https?:)?//[a-z]", re.sub(r'"data:[^"]*"', "", markup))
    assert not document.all("script")
    assert "@import" not in markup
    assert "url(" not in markup
    for node in document.all():
        for name in ("src", "href"):
            target = node.attributes.get(name)
            assert target is None or target.startswith(("data:", "#")) or node.name == "a"
    ids = [node.attributes["id"] for node in document.all() if "id" in node.attributes]
    assert len(ids) == len(set(ids))
    for link in document.all("a"):
        target = link.attributes["href"]
        assert target[1:] in ids if target.startswith("#") else not target.startswith("/")


def test_pictures_decode_to_the_size_that_is_told(document: Node) -> None:
    for image in document.all("img"):
        data = base64.b64decode(image.attributes["src"].removeprefix("data:image/webp;base64,"))
        height, width, _ = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape
        assert (image.attributes["width"], image.attributes["height"]) == (str(width), str(height))


def test_it_is_accessible(document: Node) -> None:
    assert document.all("html")[0].attributes["lang"] == "en"
    headings = [int(node.name[1]) for node in document.all() if re.fullmatch("h[1-6]", node.name)]
    assert headings[0] == 1
    assert headings.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(headings))
    assert all(node.attributes.get("scope") in ("row", "col", "rowgroup", "colgroup") for node in document.all("th"))
    for frame in document.all("div", tabindex="0"):
        assert frame.attributes["aria-label"]
    for line in [line for table in document.all("table") for line in table.all("tr")]:
        assert line.all("th"), "each row has a heading"


def test_equal_contents_give_equal_bytes(markup: str, tmp_path: Path) -> None:
    assert made_up_page(tmp_path / "again") == markup


def test_cards_give_labelled_figures_and_name_the_other_simulator(document: Node) -> None:
    cards = [card.text for card in document.all("div") if card.attributes.get("class", "").startswith("card ")]
    assert len(cards) == 4
    assert all("in another simulator" in card for card in cards)
    assert ["as labelled: 0.1" in card for card in cards] == [False, False, True, True]


def test_too_few_sequences_are_called_so() -> None:
    few = hand_made().assign(**{"1/0": lambda table: table["1/0"].mask(table["statistic"].str.contains("95"))})
    cells = tree(tables.paired(few, ("system", "statistic"), label="By hand")).all("tbody")[0].all("tr")[3].all("td")
    assert [cell.text for cell in cells] == ["too few", "0.0400 to0.0600", "0.0600 to0.0800"]


def hand_made() -> pd.DataFrame:
    return pd.DataFrame(
        [
            ("clothkit", "main", "mean", 0.03, 0.05, 0.0700001),
            ("clothkit", "main", "std", 0.01, 0.01, 0.01),
            ("clothkit", "main", "mean 95 % low", 0.02, 0.04, 0.06),
            ("clothkit", "main", "mean 95 % high", 0.04, 0.06, 0.08),
            ("clothkit", "no action", "mean", 0.2, 0.2, 0.2),
            ("paper", "main", "mean", 0.04, 0.04, 0.07),
            ("paper", "main", "std", 0.02, 0.02, 0.02),
            ("paper", "b9", "mean", 0.5, 0.5, math.nan),
        ],
        columns=["source", "system", "statistic", "1/0", "1/all", "3/all"],
    )


def test_the_better_figure_is_marked() -> None:
    table = tree(tables.paired(hand_made(), ("system", "statistic"), label="By hand"))
    rows = [
        (
            row.all("th")[0].text,
            [
                [span.text for span in cell.all("span") if "better" in span.attributes.get("class", "")]
                for cell in row.all("td")
            ],
        )
        for row in table.all("tbody")[0].all("tr")
    ]
    mean = ("mean", [["clothkit: ●0.0300 (better)"], ["paper: ●0.0400 (better)"], []])
    spread = ("st.dev.", [[], [], []])
    assert [name for name, _ in rows] == [
        "main observes voxels only; an ensemble of mesh nets",
        "mean",
        "st.dev.",
        "95 % of mean",
    ]
    # Equal as printed is neither; a spread is neither better nor worse.
    assert rows[1:3] == [mean, spread]
    assert "0.0200 to0.0400" in table.all("tbody")[0].text
    # What only one of them has is shown alone.
    assert [body.all("th")[0].text.split()[0] for body in table.all("tbody")] == ["main", "no", "b9"]
    assert [span.attributes["class"] for span in table.all("tbody")[2].all("td")[0].all("span")] == [
        "paper",
        "visually-hidden",
    ]
    upper, lower = table.all("thead")[0].all("tr")
    assert [(head.text, head.attributes["colspan"]) for head in upper.all("th")] == [
        ("1 manipulation", "2"),
        ("3 manipulations", "1"),
    ]
    assert [head.text for head in lower.all("th")] == ["from 0", "all", "all"]


@pytest.mark.parametrize(
    ("own", "paper", "ideal", "best"),
    [
        (0.1, 0.2, -math.inf, "clothkit"),
        (0.2, 0.1, -math.inf, "paper"),
        (0.1, 0.10001, -math.inf, None),
        (0.1, math.nan, -math.inf, None),
        (0.75, 0.861, 0.798, "clothkit"),
        (0.70, 0.785, 0.798, "paper"),
    ],
)
def test_better(own: float, paper: float, ideal: float, best: str | None) -> None:
    assert better(own, paper, ideal=ideal) == best


def test_text_is_escaped_and_markup_is_not() -> None:
    assert (
        element("p", "a < b", element("b", "&"), class_="x", title='"')
        == '<p class="x" title="&quot;">a &lt; b<b>&amp;</b></p>'
    )
    assert inline("*a* < `b` [c](d.md)\n") == '<em>a</em> &lt; <code>b</code> <a href="d.md">c</a>'
    assert unmarked("*a* [c](d.md)\n") == "a c"

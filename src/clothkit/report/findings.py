"""First paragraphs of a report: whether the uncertainty term, an ensemble and refinement reduced planning errors.

The words are made from the paired comparisons of planners, so that they stay true when a chain is run again.
"""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from clothkit.report.formatting import LEAST, number
from clothkit.report.layout import TASKS

LEVEL = 0.05
"""Significance level: a difference counts as found where p times the number of compared columns is below it."""

TERM = "the uncertainty term (alpha)"

PLANS = {
    "1/0": "one-step plans from the flat cloth",
    "1/1": "one-step plans from state 1",
    "1/2": "one-step plans from state 2",
    "1/all": "one-step plans from every start",
    "2/0": "two-step plans from the flat cloth",
    "2/1": "two-step plans from state 1",
    "2/all": "two-step plans from every start",
    "3/all": "three-step plans",
}

RULE = (
    f"A difference counts as found where p, times the {len(TASKS)} columns that are compared, is below {LEVEL}; "
    "[planners compared](#planners-compared) shows all comparisons.\n"
)


STUDIED = {
    ("main", "b3"): "compared with plans without the term ({count} test sequences), those with it were",
    ("main", "b2"): "compared with plans of one net without it ({count}), they were",
    ("main", "eq13"): "compared with plans by the accuracy term of eq. (13) alone ({count}), they were",
    ("eq15", "eq13"): "plans by the whole of eq. (13), with the doubt of eq. (15), were compared with those ({count})",
}
"""The comparisons of the study of doubt (studies/doubt.py --split test), in words, with their test sequences."""

STUDY = "studies/doubt_test_comparisons.csv"

CLAIM = 0.01
"""p below which the paper's claim counts as confirmed: *main* better than *b3* and *b2* where plans are longer."""

CLAIMED = {
    ("main", "b3"): ("*b3*", "without the uncertainty term"),
    ("main", "b2"): ("*b2*", "one net, without it"),
}
"""What *main* shall be better than, by pair of the study, and what that is."""

EQ15 = ("eq15", "eq13")
"""The pair of the study that tells of eq. (15)."""

LENGTHS = {"1/all": "one-step plans", "2/all": "two-step plans", "3/all": "three-step plans"}
AIMED = ("2/all", "3/all")
"""Columns of the claim: of plans of one manipulation the term has little to tell."""


def findings(comparisons: pd.DataFrame, study: pd.DataFrame | None = None, *, beside_paper: bool = True) -> list[str]:
    """Paragraphs in Markdown from the table of planners' comparisons; an empty list if nothing was compared.

    `study` are the comparisons of the study of doubt, which planned for more test sequences, if there are any; with
    them, what they tell of the paper's claim comes first.
    `beside_paper` tells whether findings are set beside the paper's.
    """
    errors = comparisons[(comparisons["split"] == "test") & (comparisons["measure"] == "error")]
    pairs = dict(iter(errors[errors["system"] == "main"].groupby("against")))
    sentences = []
    if "b3" in pairs:
        sentences.append(_term(pairs["b3"]))
    if study is not None and len(study) and sentences:
        # What most sequences tell comes first.
        sentences = [*([_claim(study)] if beside_paper else []), *sentences, *_studied(study)]
    others = {name: pairs[name] for name in ("b2", "b3") if name in pairs}
    if others and beside_paper:
        sentences.append(_lead(others))
    if "unrefined" in pairs:
        sentences.append(_refinement(pairs["unrefined"]))
    return [*sentences, RULE] if sentences else []


def _term(rows: pd.DataFrame) -> str:
    count = _sequences(rows)
    which = f"(*main* compared with *b3*, which differs in nothing else; {count} test sequences)"
    if count < LEAST:
        return f"Too few test sequences were planned for ({count}) to measure the effect of the uncertainty term.\n"
    better, worse = _found(rows, better=True), _found(rows, better=False)
    if better and worse:
        return f"With {TERM} plans were better than without it {which} in {better}, and worse in {worse}.\n"
    if better:
        return f"Plans were better with {TERM} than without it {which}: {better}.\n"
    if worse:
        return f"Plans were not found to be better with {TERM} than without it {which}, but worse in {worse}.\n"
    return f"Between plans with {TERM} and without it {which} no difference was found.\n"


def _claim(study: pd.DataFrame) -> str:
    """Whether the paper's claim is confirmed by the study of doubt, with the figures of each plan length."""
    told, verdicts = [], []
    for pair, (short, what) in CLAIMED.items():
        compared = _pair(study, pair)
        rows, count = {str(row["column"]): row for row in compared.to_dict("records")}, _sequences(compared)
        if count < LEAST:
            why = f"only {count} sequences were planned for with both" if count else "the study has no such rows"
            told.append(f"With {short} ({what}) *main* was not compared: {why}.")
            verdicts.append(f"not tested against {short}")
            continue
        shown = [f"{_apart(rows[column])} in {plans}" for column, plans in LENGTHS.items() if column in rows]
        told.append(f"Mean error of *main* beside {short} ({what}; {count} test sequences): {', '.join(shown)}.")
        met = {c: rows[c]["difference"] < 0 and rows[c]["p"] < CLAIM for c in AIMED if c in rows}
        for word, wanted in (("confirmed", True), ("not confirmed", False)):
            if columns := [LENGTHS[column] for column, found in met.items() if found == wanted]:
                verdicts.append(f"{word} against {short} for {' and '.join(columns)}")
    own = (
        "" if len(_pair(study, EQ15)) else " Plans with the paper's own measure of doubt, eq. (15), are not among them."
    )
    return (
        "The paper claims that a planner plans better if it knows what it does not know. Here that counts as confirmed "
        "where *main* is better than *b3* and than *b2* in plans of two and of three manipulations, each with p below "
        f"{CLAIM:g}. [A study]({STUDY}) executed plans for test sequences to their end without a look in between. "
        f"{' '.join(told)}{own} So the claim is {', '.join(verdicts)}.\n"
    )


def _apart(row: Mapping[Any, Any]) -> str:
    return f"{number(abs(row['difference']))} {'smaller' if row['difference'] < 0 else 'larger'} (p {row['p']:.2g})"


def _pair(study: pd.DataFrame, pair: tuple[str, str]) -> pd.DataFrame:
    return study[(study["system"] == pair[0]) & (study["against"] == pair[1])]


def _studied(study: pd.DataFrame) -> list[str]:
    """The differences that the study of doubt found, each pair with its number of sequences, if there are any."""
    parts = []
    for pair, words in STUDIED.items():
        rows = _pair(study, pair)
        count = _sequences(rows)
        if count < LEAST:
            continue
        found = {"better": _found(rows, better=True), "worse": _found(rows, better=False)}
        told = [f"{how} in {plans}" for how, plans in found.items() if plans]
        parts.append(f"{words.format(count=count)} {' and '.join(told) or 'neither better nor worse'}")
    start = f"Column by column, [the study]({STUDY}) of plans that were executed without a look in between found this"
    return [f"{start}: {'; '.join(parts)}.\n"] if parts else []


def _lead(others: dict[str, pd.DataFrame]) -> str:
    names = {"b2": "*b2* (one net)", "b3": "*b3* (without the term)"}
    enough = {name: rows for name, rows in others.items() if _sequences(rows) >= LEAST}
    if not enough:
        return "That is not enough to tell whether *main* is better than *b2* and *b3*, as it is in the paper.\n"
    leads = {name: _found(rows, better=True) for name, rows in enough.items()}
    without = [names[name] for name, lead in leads.items() if not lead]
    sentences = [
        f"As in the paper, *main* was better than {names[name]} in {lead}." for name, lead in leads.items() if lead
    ]
    if without:
        names_of = " and ".join(without)
        sentences.append(
            f"In the paper *main* is better than {names_of}; in this report's sessions this was not found."
        )
    return " ".join(sentences) + "\n"


def _refinement(rows: pd.DataFrame) -> str:
    paper = 'In the paper skipping refinement "was observed to significantly harm planning performance" (section 4.7)'
    if _sequences(rows) < LEAST:
        return f"{paper}; too few sequences were planned for here to compare.\n"
    better, worse = (_found(rows, better=which, of_other=True) for which in (True, False))
    sentences = [f"it harmed {better}"] if better else []
    sentences += [f"plans without it were better in {worse}"] if worse else []
    return (
        f"{paper}; here {', and '.join(sentences) or 'no difference was found (*main* compared with *unrefined*)'}.\n"
    )


def _sequences(rows: pd.DataFrame) -> int:
    return int(rows["sequences"].max()) if len(rows) else 0


def _found(rows: pd.DataFrame, *, better: bool, of_other: bool = False) -> str:
    """A list in words of the columns in which the first system's errors are significantly smaller (`better`) or larger.

    With `of_other`, the words say how the other system's errors compare with the first one's.
    """
    size = "smaller" if better != of_other else "larger"
    sentences = []
    for column in TASKS:
        for row in rows[rows["column"] == column].to_dict("records"):
            significant = row["sequences"] >= LEAST and row["p"] * len(TASKS) < LEVEL
            if significant and (row["difference"] < 0) == better:
                detail = f"mean error {number(abs(row['difference']))} {size}, p {row['p']:.2g}"
                sentences.append(f"{PLANS[column]} ({detail})")
    return " and ".join(part for part in (", ".join(sentences[:-1]), *sentences[-1:]) if part)

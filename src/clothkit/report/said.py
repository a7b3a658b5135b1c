"""What the report says that depends on how it was made, or on its figures; in Markdown."""

import math

import pandas as pd

from clothkit.report import budgets, captions, paper
from clothkit.report.contents import Contents
from clothkit.report.printed import number


def planned(contents: Contents) -> str:
    """Whose sequences the tables are about, and whose the paper's are."""
    counts = " and ".join(f"{count} {split}" for split, count in contents.planned.items())
    return f"Planned and executed: every task of {counts} sequences. {captions.PAPER}"


def replay(contents: Contents) -> str:
    """What next to no error of one-step plans from the flat cloth means; nothing of sequences from elsewhere."""
    error = mean(contents.tables["table_6"], "clothkit", "main", "1/0")
    if not contents.made_with.simulated or math.isnan(error):
        return ""
    return (
        f"A one-step plan from the flat cloth (state 0; *main*: {number(error)}) is a replay: the simulator is "
        "deterministic, each sequence begins with the same flat cloth, and a plan that finds the recorded manipulation "
        "again gives almost the recorded state again. Its error says that the search finds it, not how well such a "
        "plan would do on a cloth that behaves a little differently.\n"
    )


def descriptions(contents: Contents) -> str:
    """How nets see cloths, and what becomes of the memory trace; nothing where they see them as they are."""
    made_with = contents.made_with
    if not made_with.canonical:
        return ""
    voxels = captions.VOXELS_CANONICAL if made_with.voxels_canonical else captions.VOXELS_AS_THEY_ARE
    study = captions.MEMORY_STUDY if contents.studied else captions.MEMORY_UNKNOWN
    return f"{captions.CANONICAL}; {voxels}. {captions.MEMORY}{study}"


def viewport() -> str:
    """Where tables 4 and 7 stand, and why; the paper's figures from its own tables."""
    errors, voxels = paper.table(6), paper.table(7)
    pairs = " and ".join(
        f"*{system}*'s {length} from state {start} ({number(mean(errors, 'paper', system, column))} in its table 6, "
        f"{number(mean(voxels, 'paper', system, column))} in its table 7)"
        for system, column, length, start in (("main", "2/1", "two steps", 1), ("b4", "1/2", "one step", 2))
    )
    return (
        "Our figures stand above the paper's for whatever is compared, not for worse plans alone: the viewport and the "
        "resolution that the paper gives make voxels eight times finer in z than in x and y, though its text says "
        "four, and the finer voxels are, the fewer agree. *mean / no action* relates figures to what there is to be "
        "gained. Nor can the paper's table 7 be held against its table 6 across systems: equal errors of meshes are "
        f"voxel differences more than twice apart, in {pairs}.\n"
    )


def unequal(table: pd.DataFrame) -> str:
    """What the dagger means in tables of planners; nothing where there is no planner of voxels."""
    told = budgets.told(table)
    return f"†: with another budget. {told} ([budgets](#budgets)).\n" if told else ""


def unequal_nets(table: pd.DataFrame) -> str:
    """What it means in tables of predictions; nothing where a2's nets are none of a planner's."""
    told = budgets.told_of_nets(table, "*a2* predicts with the nets of *b4*, which")
    return f"†: with another budget. {told} ([budgets](#budgets)).\n" if told else ""


def mean(table: pd.DataFrame, source: str, system: str, column: str) -> float:
    """A mean of the test set; NaN if the table has none."""
    rows = table[(table["source"] == source) & (table["split"] == "test") & (table["statistic"] == "mean")]
    found = rows.loc[rows["system"] == system, column]
    return float(found.iloc[0]) if len(found) else math.nan

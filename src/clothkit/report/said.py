"""Texts of the report that depend on its settings or its figures, in Markdown."""

import math

import pandas as pd

from clothkit.report import budgets, captions, paper
from clothkit.report.contents import Contents
from clothkit.report.layout import BY_LENGTH
from clothkit.report.printed import number


def planned(contents: Contents) -> str:
    """The sentence on the number of sequences in our planning tables and in the paper's."""
    counts = " and ".join(f"{count} {split}" for split, count in contents.planned.items())
    return f"Planned and executed: every task of {counts} sequences. {captions.PAPER}"


def replay(contents: Contents) -> str:
    """What the small error of one-step plans from the flat cloth means; "" for sequences from another simulator."""
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
    """How canonical nets describe cloths, and how they use the memory trace; "" if mesh nets are not canonical."""
    made_with = contents.made_with
    if not made_with.canonical:
        return ""
    voxels = captions.VOXELS_CANONICAL if made_with.voxels_canonical else captions.VOXELS_AS_THEY_ARE
    return f"{captions.CANONICAL}; {voxels}. {captions.MEMORY}{_memory(contents)}"


def _memory(contents: Contents) -> str:
    """What carrying the memory trace on was worth, by the study of it."""
    study = contents.memory
    carried = None if study is None else study[study["system"] == "carried"]
    if carried is None or carried.empty:
        return captions.MEMORY_UNKNOWN
    difference = carried["difference"]
    return captions.MEMORY_STUDY.format(
        sequences=int(carried["sequences"].min()), low=difference.min(), high=difference.max(), p=carried["p"].max()
    )


def viewport(contents: Contents, name: str, in_meshes: str) -> str:
    """How a table of voxel differences compares with the paper's, and the known reasons.

    `in_meshes` names the table with the errors of the same meshes.
    """
    voxels, meshes = (contents.tables.get(table, pd.DataFrame()) for table in (name, in_meshes))
    stands = []
    for system in () if voxels.empty else voxels.loc[voxels["source"] == "paper", "system"].drop_duplicates():
        times, errors = _times(voxels, system), "" if meshes.empty else _times(meshes, system)
        if times:
            also = f" ({errors} in {in_meshes.replace('_', ' ')})" if errors else ""
            stands.append(f"those of *{system}* are {times} the paper's{also}")
    where = f"Of our means by length, {', '.join(stands)}. " if stands else ""
    given, told = paper.table(6), paper.table(7)
    pairs = " and ".join(
        f"*{system}*'s {length} from state {start} ({number(mean(given, 'paper', system, column))} in its table 6, "
        f"{number(mean(told, 'paper', system, column))} in its table 7)"
        for system, column, length, start in (("main", "2/1", "two steps", 1), ("b4", "1/2", "one step", 2))
    )
    return (
        f"{where}Two things are known of it. The viewport and the resolution that the paper gives make voxels eight "
        "times finer in z than in x and y, though its text says four, and the finer voxels are, the fewer agree: the "
        "table below, for a viewport of height 0.25, has voxels four times finer. And the paper's own table 7 is not "
        "consistent with its table 6 across systems: nearly equal errors of meshes are voxel differences more than "
        f"twice apart, in {pairs}. *mean / no action* relates our figures to what there is to be gained.\n"
    )


def _times(table: pd.DataFrame, system: str) -> str:
    """The ratio of our means to the paper's in words, from the least to the largest over all lengths."""
    pairs = [(mean(table, "clothkit", system, column), mean(table, "paper", system, column)) for column in BY_LENGTH]
    found = [own / other for own, other in pairs if not math.isnan(own / other)]
    return f"{min(found):.2f} to {max(found):.2f} times" if found else ""


def unequal(table: pd.DataFrame) -> str:
    """What the dagger means in tables of planners; "" if there is no voxel planner."""
    told = budgets.told(table)
    return f"†: with another budget. {told} ([budgets](#budgets)).\n" if told else ""


def unequal_nets(table: pd.DataFrame) -> str:
    """What the dagger means in tables of predictions; "" if no planner uses a2's nets."""
    told = budgets.told_of_nets(table, "*a2* predicts with the nets of *b4*, which")
    return f"†: with another budget. {told} ([budgets](#budgets)).\n" if told else ""


def mean(table: pd.DataFrame, source: str, system: str, column: str) -> float:
    """A mean of the test set from a table; NaN if the table lacks it."""
    rows = table[(table["source"] == source) & (table["split"] == "test") & (table["statistic"] == "mean")]
    found = rows.loc[rows["system"] == system, column]
    return float(found.iloc[0]) if len(found) else math.nan

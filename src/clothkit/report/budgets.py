"""Budgets of each system for planning and training, and which systems are compared with unequal budgets."""

import math
from collections.abc import Mapping, Sequence
from functools import cache

import jax
import numpy as np
import pandas as pd

from clothkit.models.settings import EMDVoxelConfig, PEMDConfig
from clothkit.models.store import shapes
from clothkit.planning.search import SearchConfig
from clothkit.planning.systems import SYSTEMS
from clothkit.report.layout import LENGTHS
from clothkit.report.run_settings import Net, RunSettings, TrainedNet
from clothkit.training.settings import TrainingConfig

EQUAL = 0.05
"""Budgets count as equal if they differ by at most this share of the larger one."""

DAGGER = " †"
"""Suffix of the name of a system that is compared with a system with another budget."""

VTM = "vtm"

PAPER: Mapping[str, Net] = {"main": PEMDConfig(), "b4": EMDVoxelConfig()}
"""The paper's forward models. Its search and its training are the defaults of SearchConfig and TrainingConfig."""

ITERATIONS = tuple(f"iterations_{length}" for length in LENGTHS)
EVALUATIONS = tuple(f"evaluations_{length}" for length in LENGTHS)


def budgets(settings: RunSettings, timings: pd.DataFrame | None, systems: list[str]) -> pd.DataFrame:
    """The table of budgets: a row per planner, one for VtM, and the paper's rows.

    Columns: source, system; nets (number of forward models used in planning: the ensemble, or the best net of it),
    parameters (of each net), training_iterations, batch, training_cpu_minutes (of the ensemble's forward models
    together, or of VtM; NaN where the training left no note), strains (plans that an iteration changes), iterations_1,
    _2, _3 (of a search, by plan length), evaluations_1, _2, _3 (of the loss, with or without its gradient).
    """
    rows, members = [], settings.ensemble.members
    for name in systems:
        system = SYSTEMS[name]
        net, search = (settings.emd_voxel, settings.voxel_search) if system.voxels else (settings.pemd, settings.search)
        assert net is not None, "a scale without voxel nets has no systems that plan in voxels"
        minutes = _minutes(timings, "train_emd_voxel" if system.voxels else "train_pemd", members)
        rows.append(_row("clothkit", name, 1 if system.single else len(members), net, search, minutes))
    rows.append(_row("clothkit", VTM, 1, settings.vtm, None, _minutes(timings, "train_vtm")))
    for name, published in PAPER.items():
        rows.append(_row("paper", name, 2, TrainedNet(published, TrainingConfig()), SearchConfig(), math.nan))
    return pd.DataFrame(rows).astype(dict.fromkeys(("strains", *ITERATIONS, *EVALUATIONS), "Int64"))


def _row(
    source: str, system: str, nets: int, net: TrainedNet, search: SearchConfig | None, minutes: float
) -> dict[str, object]:
    iterations, plans, evaluations = (dict.fromkeys(LENGTHS, math.nan) for _ in range(3))
    if search is not None:
        for length in LENGTHS:
            iterations[length], plans[length] = search.optimiser.shape(int(length))
            evaluations[length] = search.optimiser.evaluations(int(length))
    return {
        "source": source,
        "system": system,
        "nets": nets,
        "parameters": _parameters(net.net),
        "training_iterations": net.training.iterations,
        "batch": net.training.batch,
        "training_cpu_minutes": minutes,
        "strains": plans[LENGTHS[-1]],
        **{f"iterations_{length}": count for length, count in iterations.items()},
        **{f"evaluations_{length}": count for length, count in evaluations.items()},
    }


@cache
def _parameters(net: Net) -> int:
    return sum(int(np.prod(leaf.shape)) for leaf in jax.tree.leaves(shapes(net)))


def _minutes(timings: pd.DataFrame | None, stage: str, members: Sequence[int] = ()) -> float:
    """CPU minutes of the last training run of each of a stage's nets, added up; NaN if there is no note of any.

    Of an ensemble only the members count, as far as they are named by number, which they are not in older reports.
    """
    if timings is None:
        return math.nan
    own = timings[timings["stage"].astype(str).str.split("@").str[0] == stage]
    numbered = own[own["stage"].isin([f"{stage}@{member}" for member in members])]
    own = numbered if len(numbered) else own
    return float(own["cpu_seconds"].sum()) / 60 if len(own) else math.nan


def differ(table: pd.DataFrame, system: str, against: str) -> bool:
    """Whether two planners have unequal budgets for search or training. Unknown budgets count as equal."""
    one, other = (_of(table, name) for name in (system, against))
    if one is None or other is None:
        return False
    return any(_apart(float(one[name]), float(other[name])) for name in (*EVALUATIONS, "training_cpu_minutes"))


def difference(table: pd.DataFrame) -> str:
    """How the voxel baseline's budget differs from main's, in words; "" if either planner is missing."""
    main = _of(table, "main")
    voxels = [name for name in dict.fromkeys(table["system"]) if name in SYSTEMS and SYSTEMS[name].voxels]
    other = _of(table, voxels[0]) if voxels else None
    if main is None or other is None:
        return ""
    times = [main[name] / other[name] for name in EVALUATIONS]
    names = " and ".join(f"*{name}*" for name in voxels)
    fewer = f"{names} search with {min(times):.2g} to {max(times):.2g} times fewer evaluations of the loss than *main*"
    return f"{fewer}; {difference_of_training(table, 'their nets')}"


def difference_of_training(table: pd.DataFrame, whose: str) -> str:
    """How long the voxel baseline's nets and main's were trained, in words; "" if b4 or main is missing.

    `whose` names the voxel baseline's nets in the sentence.
    """
    voxels, main = (_of(table, name) for name in ("b4", "main"))
    if voxels is None or main is None:
        return ""
    minutes = [row["training_cpu_minutes"] for row in (voxels, main)]
    if any(map(math.isnan, minutes)):
        return f"{whose} were trained for an unknown time"
    return f"{whose} were trained for {minutes[0]:.0f} CPU minutes, those of *main* for {minutes[1]:.0f}"


def _of(table: pd.DataFrame, system: str) -> pd.Series | None:
    own = table[(table["source"] == "clothkit") & (table["system"] == system)]
    return own.iloc[0] if len(own) else None


def _apart(one: float, other: float) -> bool:
    return bool(abs(one - other) > EQUAL * max(one, other)) if not math.isnan(one + other) else False

"""The study of hands: which share each row was searched with, and what its summary says."""

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest

from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.params import Params
from clothkit.planning.planner import Planner
from tests import tiny
from tests.app.plans import BOTH, ONE
from tests.observation.scenes import folded


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies"))
    import hands

    return hands


def table(gain: float, kind: str, one_handed: int = 0) -> pd.DataFrame:
    """Plans of one manipulation and of two for twelve sequences."""
    length = np.tile([1, 2], 12)
    return pd.DataFrame(
        {
            "kind": kind,
            "goal": "",
            "sequence": np.repeat(np.arange(12), 2),
            "start": 0,
            "length": length,
            "error": 0.1 * length + gain,
            "error_no_action": 0.3,
            "one_handed": one_handed * length,
        }
    )


def test_summary_pairs_shares_problem_by_problem(study: ModuleType) -> None:
    tables = [table(gain, "tasks", one).assign(share=share) for share, gain, one in ((1 / 3, 0.0, 1), (0.0, -0.02, 0))]
    found = study.summary(pd.concat(tables)).set_index(["share", "length"])
    assert found.loc[(0.0, 2), "error"] == pytest.approx(0.18)
    np.testing.assert_allclose(found.loc[0.0, ["difference", "difference_low", "difference_high"]], -0.02)
    np.testing.assert_allclose(found.loc[1 / 3, "difference"], 0)
    assert found["one_handed"].tolist() == [1, 1, 0, 0]
    # Twelve equal differences: of the 4,096 patterns of signs, two are as far from zero.
    assert (found.loc[0.0, "p"] < 0.002).all()
    assert (found["plans"] == 12).all()


def test_each_share_is_searched_with(study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny.write_params(tmp_path / "params.yaml")
    tiny.write_nets(tmp_path / "data")
    asked: list[Any] = []

    def goals(planner: Planner, execute: Any, params: Params, told: Any) -> pd.DataFrame:
        asked.append((planner.settings.search.one_handed, params.scale, told.goals, told.cloths))
        return table(0.5, "goals")

    monkeypatch.setattr(study, "planned_goals", goals)
    monkeypatch.setattr(
        sys, "argv", ["hands", "3", "--nets", "data", "--goals", "half", "--shares", "0.5", "0", "--seed", "7"]
    )
    study.main()
    assert asked == [(0.5, "smoke", ["half"], 3), (0.0, "smoke", ["half"], 3)]
    assert pd.read_csv("reports/smoke/studies/hands_seed_7.csv")["share"].unique().tolist() == [0.5, 0]
    assert len(pd.read_csv("reports/smoke/studies/hands_summary_seed_7.csv")) == 4


def test_a_row_has_what_was_executed(study: ModuleType) -> None:
    tried = Executed(plan=np.stack([[[ONE], [BOTH]], [[ONE], [ONE]], [[BOTH], [ONE]]]))
    rows = study.rows_of(tried, ["half"] * 3, kind="goals")
    # The second session's last manipulation was not executed, and the third session had but one.
    assert rows["one_handed"].tolist() == [1, 1, 0]
    np.testing.assert_allclose(rows["error"], 0, atol=1e-6)
    assert (rows["error_no_action"] > 0.1).all()


class Executed:
    """What the study reads of sessions: a cloth is folded in half."""

    sequence, start, length = np.arange(3), np.zeros(3, int), np.array([2, 2, 1])
    null = np.array([[False, False], [False, True], [False, False]])
    cloth = np.tile(PAPERS_CLOTH, (3, 1))
    state = np.stack([[SQUARE.flat(), folded(along=0.0), folded(along=0.0)]] * 3)
    goal = np.stack([folded(along=0.0)] * 3)

    def __init__(self, plan: np.ndarray) -> None:
        self.plan = plan

    def __len__(self) -> int:
        return len(self.plan)

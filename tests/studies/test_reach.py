"""The study of reach: how plans come about that stay inside, what their outcomes are, and what the summary says."""

import dataclasses
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from clothkit.app.inputs import load_settings
from clothkit.app.options import observation_options
from clothkit.app.planner import for_one_cloth
from clothkit.cloth.mesh import error
from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import TASKS, Task
from clothkit.episodes.record import tasks_of_dataset
from clothkit.planning.planner import Planner
from clothkit.planning.reach import Box, Limits
from clothkit.planning.search import evaluated
from clothkit.planning.types import Found, Problem
from clothkit.report.layout import REACH
from tests.app.plans import finding
from tests.planning import toy
from tests.toy_dataset import dataset

CORNER = np.array([[1, 1, 1, 1, -0.7, -0.5]], np.float32)
"""A corner of the flat cloth, where x and y are 0.2 m, to the middle."""
ACROSS = np.array([[1, 1, 1, 1, -0.45, -0.65]], np.float32)
SHORT = np.array([[1, 1, 1, 1, -0.45, -0.35]], np.float32)


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.chdir(tmp_path)  # without params.yaml
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies"))
    import reach

    return reach


def search(self: Planner, *given: object, **how: object) -> object:
    """In place of searches: CORNER without limits, SHORT within them."""
    with finding(SHORT if "out_of_reach" in self.terms else CORNER):
        return self.search(*given, **how)  # type: ignore[arg-type]


def from_flat() -> Dataset:
    """A sequence whose first state is flat, in the middle of the table, and whose second one CORNER makes of it."""
    data = dataset(1)
    vertices, centre = data.vertices.copy(), data.centre.copy()
    vertices[0, 0], centre[0, 0] = SQUARE.flat(), 0
    vertices[0, 1] = toy.dragged(jnp.asarray(SQUARE.flat()), jnp.asarray(CORNER[0]))
    return dataclasses.replace(data, vertices=vertices, centre=centre)


def test_plans_are_found_turned_searched_or_none(study: ModuleType, tmp_path: Path) -> None:
    """The plan without limits is known; so is what a search with limits finds instead."""
    settings = load_settings(tmp_path / "data")
    planner = for_one_cloth(toy.planner("b1"))
    tasks = tasks_of_dataset(from_flat(), [Task(0, 0, 1)], "validation")
    far = 9.0
    boxes = {
        # All; the corner where x is least; as near to the middle as no corner is; nowhere.
        ("square", 9.0): Box((-far, -far, -far), (far, far, far)),
        ("side", 0.1): Box((-far, -far, -far), (0.1, far, far)),
        ("square", 0.15): Box((-0.21, -0.21, -far), (0.21, 0.21, 0.02)),
        ("square", 0.01): Box((-0.01, -0.01, -far), (0.01, 0.01, far)),
    }
    wanted = {key: Limits((box,)) for key, box in boxes.items()}
    options = observation_options(settings.app, side=study.SIDE)
    with mock.patch.object(Planner, "search", search):
        table = study.rows_of(planner, settings, options, tasks, wanted, toy.execute).set_index(study.REGION)
    assert table["how"].to_dict() == {
        ("square", 9.0): "found",
        ("side", 0.1): "turned",
        ("square", 0.15): "none",
        ("square", 0.01): "none",
    }
    assert (table["split"] == "validation").all()
    assert (table[study.KEYS] == [0, 0, 1]).all(axis=None)
    still = float(error(SQUARE.flat(), tasks.goal[0], aligned=True))
    np.testing.assert_allclose(table["error_no_action"], still, rtol=1e-5)
    np.testing.assert_allclose(table["error_free"], 0, atol=1e-4)
    # Turned with its goal it does as well; where there is no plan, nothing is done.
    assert table["error"].tolist() == pytest.approx([0, 0, still, still], abs=1e-4)
    assert table["expected"].isna().tolist() == [False, False, True, True]


def test_what_a_search_finds_is_executed(study: ModuleType, tmp_path: Path) -> None:
    settings = load_settings(tmp_path / "data")
    planner = for_one_cloth(toy.planner("b1"))
    bent = dataset(1)
    goal = np.asarray(toy.dragged(jnp.asarray(bent.vertices[0, 0]), jnp.asarray(CORNER[0])))
    vertices = bent.vertices.copy()
    vertices[0, 1] = goal
    tasks = tasks_of_dataset(dataclasses.replace(bent, vertices=vertices), [Task(0, 0, 1)], "validation")

    # What SHORT leads to is farther in x than what CORNER does.
    middle = (tasks.start[0, -1, -1, 0] + CORNER[0, 4] / 2 + SHORT[0, 4] / 2 + tasks.centre[0, 0]) * 0.4 / 1.4
    wanted = {("side", 0.1): Limits((Box((float(middle), -9, -9), (9, 9, 9)),))}
    options = observation_options(settings.app, side=study.SIDE)
    with mock.patch.object(Planner, "search", search):
        (row,) = study.rows_of(planner, settings, options, tasks, wanted, toy.execute).to_dict("records")
    assert row["how"] == "searched"
    outcome = toy.dragged(jnp.asarray(tasks.start[0]), jnp.asarray(SHORT[0]))
    by_hand = float(error(outcome, tasks.goal[0], aligned=True))
    assert row["error"] == pytest.approx(by_hand, abs=1e-3)
    assert row["error_free"] == pytest.approx(0, abs=1e-3)
    assert 0.001 < by_hand < row["error_no_action"]


def test_what_a_search_finds_for_a_turned_goal_is_not_what_turning_finds(study: ModuleType, tmp_path: Path) -> None:
    """No form of CORNER stays inside; mirrored, with x and y exchanged, it almost does, and ACROSS comes near to it."""
    settings = load_settings(tmp_path / "data")
    planner = for_one_cloth(toy.planner("b1"))
    tasks = tasks_of_dataset(from_flat(), [Task(0, 0, 1)], "validation")
    wanted = {("side", 0.06): Limits((Box((0.06, -0.02, -9), (9, 9, 9)),))}

    def known(self: Planner, problems: Problem, keys: Any, *, length: int) -> Found:
        plan, of = (ACROSS if "out_of_reach" in self.terms else CORNER)[None], (problems, self.objective(length))
        # In the goal's labelling that fits it best, as a search would find it.
        each = [
            evaluated(self.model, self.representation, self.nets, *of, plan, np.full(1, label), keys)
            for label in range(8)
        ]
        return min(each, key=lambda found: float(found.terms["accuracy"].sum()))

    options = observation_options(settings.app, side=study.SIDE)
    with mock.patch.object(Planner, "search", known):
        table = study.rows_of(planner, settings, options, tasks, wanted, toy.execute)
    (row,) = table.to_dict("records")
    assert row["how"] == "searched"
    # The goal is turned with the plan: its error is small, if x and y are exchanged.
    outcome = toy.dragged(jnp.asarray(tasks.start[0]), jnp.asarray(ACROSS[0]))
    by_hand = float(error(outcome, tasks.goal[0][..., [1, 0, 2]], aligned=True))
    assert row["error"] == pytest.approx(by_hand, abs=1e-3)
    assert by_hand < 0.5 * float(error(outcome, tasks.goal[0], aligned=True))
    inside = study.summary(table).set_index("way")["inside"]
    assert inside.to_dict() == {"turning": 0, "terms": 1}


def rows(sequences: int = 12) -> pd.DataFrame:
    """Of the square all plans are found; of the side one in four each is found, turned, searched, or there is none."""
    hows = ("found", "turned", "searched", "none")
    return pd.DataFrame(
        [
            {
                "region": region,
                "size": size,
                "sequence": sequence,
                "start": start,
                "length": length,
                "how": "found" if region == "square" else hows[sequence % 4],
                "error": 0.5 if region == "side" and sequence % 4 == 3 else 0.1 + 0.02 * (sequence % 4),
                "error_free": 0.1,
                "error_no_action": 0.5,
            }
            for region in ("square", "side")
            for size in ((0.3, 0.25) if region == "square" else (0.1, 0.0))
            for sequence in range(sequences)
            for start, length in TASKS
        ]
    )


def test_summary(study: ModuleType, tmp_path: Path) -> None:
    found = study.summary(rows()).set_index(["region", "size", "way"])
    assert len(found) == 8
    assert set(REACH) <= set(found.reset_index().columns)
    for way in study.WAYS:
        one = found.loc[("square", 0.3, way)]
        assert one["tasks"] == 72
        assert one[["inside", "inside_low", "inside_high"]].tolist() == [1, 1, 1]
        assert one["error"] == one["error_inside"] == pytest.approx((0.1 + 0.12 + 0.14 + 0.16) / 4)
    turning, terms = (found.loc[("side", 0.1, way)] for way in ("turning", "terms"))
    assert (turning["inside"], turning["turned"], turning["searched"]) == (0.5, 0.25, 0)
    assert (terms["inside"], terms["turned"], terms["searched"]) == (0.75, 0.25, 0.25)
    assert turning["error_inside"] == pytest.approx((0.1 + 0.12) / 2)
    assert terms["error_inside"] == pytest.approx((0.1 + 0.12 + 0.14) / 3)
    # Where there is no plan, nothing is done.
    assert turning["error"] == pytest.approx((0.1 + 0.12 + 0.5 + 0.5) / 4)
    assert terms["error"] == pytest.approx((0.1 + 0.12 + 0.14 + 0.5) / 4)
    assert terms["error_low"] < terms["error"] < terms["error_high"]
    assert terms["error_free_inside"] == pytest.approx(0.1)
    study.draw(found.reset_index(), tmp_path / "reach.png")
    assert (tmp_path / "reach.png").stat().st_size > 10_000


def test_what_is_there_is_not_computed_again(study: ModuleType) -> None:
    table = rows(1)
    left = study.missing(table, Task(0, 0, 1))
    there = {("square", 0.3), ("square", 0.25), ("side", 0.1), ("side", 0.0)}
    assert set(study.regions()) - set(left) == there
    assert study.missing(table, Task(1, 0, 1)) == study.regions()
    other = table.assign(size=table["size"] + 0.001)
    pd.testing.assert_frame_equal(study.in_force(pd.concat([table, other])), table)
    assert study.missing(study.in_force(table[:0]), Task(0, 0, 1)) == study.regions()
    side, square = (study.regions()[key].hands[0] for key in (("side", 0.1), ("square", 0.25)))
    assert (side.low[:2], side.high[:2]) == ((-0.1, -study.FAR), (study.FAR, study.FAR))
    assert (square.low[:2], square.high[:2]) == ((-0.25, -0.25), (0.25, 0.25))

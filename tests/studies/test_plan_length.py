"""The study of the number of manipulations: its rows are the sessions', and its tables say what the rows say."""

import dataclasses
from itertools import product
from pathlib import Path
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from clothkit.params import load_params
from clothkit.planning import objective as objectives
from clothkit.planning.agent import begin, perceive
from clothkit.planning.batches import take
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.optimisers.random_shooting import RandomShootingConfig
from clothkit.planning.plans import pose
from clothkit.planning.types import UNKNOWN, Found, Observation
from clothkit.report.layout import PLAN_LENGTH, PLAN_WAYS
from tests.episodes.test_sessions import MANIPULATIONS, dataset
from tests.planning import toy
from tests.planning.test_lengths import finding


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "studies"))
    import plan_length

    return plan_length


def test_rows_of_sessions_in_the_toy_world(study: ModuleType) -> None:
    """Searches from state 0 know the recorded manipulations; those from later states do not know what helps."""
    planner, data = toy.planner("b1"), dataset(1)
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        told = study.run(planner, data, [0], "test", "1", toy.execute, 0.01)
        chosen = study.run(planner, data, [0], "test", "chosen", toy.execute, 0.01)
    for rows in (told, chosen):
        assert rows[["start", "length"]].to_numpy().tolist() == [[0, 1], [1, 1], [2, 1], [0, 2], [1, 2], [0, 3]]
        assert set(rows["split"]) == {"test"}
        np.testing.assert_allclose(rows["expected_no_action"], rows["error_no_action"], atol=1e-5)
    assert (told["planned"] == 1).all()
    assert told["error"][0] < 0.01
    # From state 0, as many as were recorded; then nothing is left to improve, and the session is over.
    from_first = chosen[chosen["start"] == 0]
    assert from_first["planned"].tolist() == [1, 2, 3]
    assert from_first["used"].iloc[0] == 1
    assert from_first["error"].iloc[0] == pytest.approx(told["error"][0], abs=1e-6)
    none = chosen[chosen["planned"] == 0]
    np.testing.assert_allclose(none["error"], none["error_no_action"])
    assert (none["used"] == 0).all()


def test_what_such_plans_came_to(study: ModuleType) -> None:
    """By a map that plans of n manipulations end 0.05 n from their goals, whatever is expected of them."""
    trust = ErrorMap(
        ("expected", "sigma"), np.ones(2), np.log(0.05 * np.arange(1, 4)), np.zeros(2), np.ones(1), np.ones((1, 3))
    )
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        for steps in ("1", "3"):
            found = study.run(toy.planner("b1"), dataset(1), [0], "test", steps, toy.execute, 0.01, trust)
            np.testing.assert_allclose(found["trusted"], 0.05 * int(steps), rtol=1e-5)
        chosen = study.run(toy.planner("b1"), dataset(1), [0], "test", "chosen", toy.execute, 0.01, trust)
        free = study.run(toy.planner("b1"), dataset(1), [0], "test", "chosen", toy.execute, 0.01)
    assert free["trusted"].isna().all()
    worse = 0.05 * free["planned"] > free["expected_no_action"]
    assert 0 < (worse & (free["planned"] > 0)).sum() < (free["planned"] > 0).sum()
    # The agent of the study is that of the command line, which does nothing then.
    assert chosen["planned"].tolist() == np.where(worse, 0, free["planned"]).tolist()


def rows(steps: str, *, error: float, expected: float, used: int, sequences: int = 12) -> pd.DataFrame:
    keys = pd.DataFrame(list(product(range(sequences), (1, 2))), columns=["sequence", "length"])
    return keys.assign(
        split="validation",
        system="main",
        steps=steps,
        start=0,
        planned=used,
        used=used,
        expected=expected,
        expected_no_action=0.3,
        trusted=np.nan,
        error=error + 0.001 * keys["sequence"],
        error_no_action=0.4,
    )


@pytest.fixture
def table() -> pd.DataFrame:
    """One manipulation is expected to help much, two a bit more, three no more; and so it is."""
    values = {"1": (0.1, 0.08), "2": (0.09, 0.07), "3": (0.12, 0.07)}
    ways = [rows(steps, error=error, expected=expected, used=int(steps)) for steps, (error, expected) in values.items()]
    return pd.concat(ways, ignore_index=True)


def test_what_a_margin_would_have_chosen(study: ModuleType, table: pd.DataFrame) -> None:
    for margin, used, error in ((0.0, 2, 0.09), (0.005, 2, 0.09), (0.02, 1, 0.1), (0.5, 1, 0.1)):
        found = study.replayed(table, margin)
        assert len(found) == 24
        assert (found["used"] == used).all()
        np.testing.assert_allclose(found["error"], error + 0.001 * found["sequence"])
    # Where no number is expected to help, nothing is done.
    found = study.replayed(table.assign(expected_no_action=0.06), 0.0)
    assert (found["used"] == 0).all()
    assert (found["error"] == 0.4).all()
    # Nor where such plans ended farther from their goals than the cloth lies: two are chosen, which come to no good.
    for steps, used in (("2", 0), ("1", 2)):
        found = study.replayed(table.assign(trusted=np.where(table["steps"] == steps, 0.31, 0.29)), 0.0)
        assert (found["used"] == used).all()


def test_the_largest_margin_that_is_as_good_as_the_best(study: ModuleType, table: pd.DataFrame) -> None:
    found = study.margins(table).set_index("margin")
    # All sequences agree that two are better than one, by 0.01: up to that, the margin costs nothing.
    assert found["chosen"][found["chosen"] == 1].index.tolist() == [0.0075]
    assert found["error"][0.0] == pytest.approx(0.09 + 0.001 * 5.5)
    assert found["difference"][0.02] == pytest.approx(0.01)
    # If half of the sequences lose and half win about as much, the difference is within its standard error.
    noisy = table.assign(error=table["error"] + 0.2 * (-1.0) ** table["sequence"] * (table["steps"] == "1"))
    found = study.margins(noisy).set_index("margin")
    assert found["chosen"][found["chosen"] == 1].index.tolist() == [0.1]


def test_the_summary_pairs_what_was_chosen_with_what_was_recorded(
    study: ModuleType, table: pd.DataFrame, tmp_path: Path
) -> None:
    whole = pd.concat([table, study.replayed(table, 0.005)[table.columns]], ignore_index=True)
    found = study.summary(whole).set_index(["steps", "column"])
    assert found["error"]["given", "1/all"] == pytest.approx(0.1 + 0.0055)
    assert found["error"]["given", "2/all"] == pytest.approx(0.09 + 0.0055)
    assert found["used"]["given", "all"] == pytest.approx(1.5)
    assert found["used"]["chosen", "all"] == pytest.approx(2)
    assert found["as_recorded"]["chosen", "1/all"] == 0
    assert found["as_recorded"]["chosen", "2/all"] == 1
    assert found["difference"]["chosen", "1/all"] == pytest.approx(-0.01)
    assert found["difference"]["chosen", "2/all"] == pytest.approx(0, abs=1e-12)
    assert found["difference_low"]["chosen", "1/all"] <= -0.01 + 1e-9
    assert found["difference"].drop("chosen", level="steps").isna().all()
    assert found["error_low"]["1", "1/all"] < found["error"]["1", "1/all"] < found["error_high"]["1", "1/all"]
    assert set(PLAN_LENGTH) <= set(found.reset_index().columns)
    study.draw(found.reset_index(), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


REPORTS = Path(__file__).parents[2] / "reports"


def test_the_margin_in_force_is_the_one_that_the_study_chose() -> None:
    params = load_params(Path(__file__).parents[2] / "params.yaml")
    path = REPORTS / params.scale / "studies/plan_length_margins.csv"
    if not path.exists():
        pytest.skip("the study was not run with the nets in force")
    found = pd.read_csv(path)
    assert found.loc[found["chosen"] == 1, "margin"].tolist() == [params.app.length.margin]


def test_the_loss_over_intermediate_states_is_that_of_the_best_prefix(study: ModuleType) -> None:
    planner, start = toy.planner("b1"), toy.bent()
    folds = np.array([[-1, -1, -1, -1, 0.6, 0.5], [1, 1, 1, 1, -0.7, -0.3], [-1, 1, -1, 1, 0.5, -0.6]], np.float32)
    goals = [start]
    for fold in folds:
        goals.append(np.asarray(toy.dragged(jnp.asarray(goals[-1]), jnp.asarray(fold))))
    for count in (1, 2, 3):
        memory = begin(planner, goals[count][None], np.array([3]))
        state, candidates = perceive(planner, Observation(meshes=start[None]), memory)
        problem = jax.tree.map(jnp.asarray, take(pose(planner, state, candidates, memory, 3), 0))
        fixed = objectives.fix(planner.model, planner.representation, planner.nets, problem)
        of = (planner.model, planner.representation, planner.nets, fixed)
        common, relative = jnp.zeros(1, jnp.int32), jnp.full(1, UNKNOWN)
        # Each prefix by itself, with the objective of its own length.
        losses = [
            float(
                objectives.evaluate(planner.objective(n), *of, jnp.asarray(folds[None, :n]), common, relative).loss[0]
            )
            for n in (1, 2, 3)
        ]
        found = study.intermediate.nearest_step(planner.objective(3), *of, jnp.asarray(folds[None]), common, relative)
        assert float(found.loss[0]) == pytest.approx(min(losses), rel=1e-4)
        assert int(np.argmin(losses)) == count - 1
        assert found.terms["accuracy"].shape == (1, 2)


def test_plans_that_are_cut_beside_those_of_their_own(study: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """All searches know the recorded manipulations: from state 0, the longest plan is cut to what the goal takes."""
    planner, data = toy.planner("b1"), dataset(1)

    def search(planner: object, problems: object, keys: object) -> Found:
        return planner.search(problems, keys, length=3)  # type: ignore[attr-defined]

    monkeypatch.setattr(study.intermediate, "search_for_any", search)
    with finding({n: MANIPULATIONS[:n] for n in (1, 2, 3)}):
        found = study.intermediate.rows_of(planner, data, [0], "validation", toy.execute)
    assert found["way"].value_counts().to_dict() == {"own": 18, "cut": 6}
    cut = found[found["way"] == "cut"].reset_index(drop=True)
    from_first = cut[cut["start"] == 0]
    assert from_first["n"].tolist() == from_first["length"].tolist() == [1, 2, 3]
    assert from_first["error"].iloc[0] < 0.01
    # The same manipulations come to the same, however they were found.
    own = cut[["start", "length", "n"]].merge(found[found["way"] == "own"], on=["start", "length", "n"])
    np.testing.assert_allclose(own["error"], cut["error"], atol=1e-5)
    np.testing.assert_allclose(own["expected"], cut["expected"], atol=1e-5)


def test_a_search_for_any_step_finds_what_one_manipulation_reaches(study: ModuleType) -> None:
    """With real searches: of a plan of three, one state comes about as near to a goal of one as a plan of one does."""
    optimiser = RandomShootingConfig(plans=256, chunk=64, finalists=4)
    looking = dataclasses.replace(toy.SEARCH, optimiser=optimiser)
    settings = dataclasses.replace(toy.planner("b1").settings, search=looking)
    planner, start = dataclasses.replace(toy.planner("b1"), settings=settings), toy.bent()
    goal = np.asarray(toy.dragged(jnp.asarray(start), jnp.array([1, -1, 1, 1, -1.2, 0.0])))[None]
    memory = begin(planner, goal, np.array([3]))
    state, candidates = perceive(planner, Observation(meshes=start[None]), memory)
    problems, keys = pose(planner, state, candidates, memory, 3), jax.random.key(0).reshape(1)
    any_step = study.intermediate.search_for_any(planner, problems, keys)
    last = planner.search(problems, keys, length=3)
    assert float(any_step.loss[0]) < float(last.loss[0])


def test_the_summary_of_ways_pairs_plans_of_as_many_manipulations(study: ModuleType) -> None:
    """Plans that are cut are of two manipulations, and worse by 0.02 than their own of two, by 0.01 expected."""
    base = rows("1", error=0.1, expected=0.05, used=1).drop(columns=["steps", "used", "planned", "trusted"])
    own = [base.assign(way="own", n=n, error=base["error"] + 0.5 * (n != 2)) for n in (1, 2, 3)]
    cut = base.assign(way="cut", n=2, error=base["error"] + 0.02, expected=0.06)
    found = study.intermediate.summary(pd.concat([*own, cut], ignore_index=True))
    assert tuple(found.columns) == PLAN_WAYS
    by = found.set_index(["measure", "column"])
    assert by["difference"]["error", "1/all"] == pytest.approx(0.02)
    assert by["difference"]["expected", "2/all"] == pytest.approx(0.01)
    assert by["own"]["error", "1/all"] == pytest.approx(0.1 + 0.0055)
    assert by["cut"]["error", "1/all"] == pytest.approx(0.12 + 0.0055)
    assert (found["sequences"] == 12).all()

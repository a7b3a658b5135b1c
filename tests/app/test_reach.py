"""Plans within reach through agent and command: turned if that helps, else searched for, else refused in a sentence."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.app import agent_state
from clothkit.app import plan as plan_command
from clothkit.app.agent import Agent
from clothkit.app.inputs import load_settings
from clothkit.app.options import observation_options
from clothkit.app.plan import summary
from clothkit.app.plan_file import Plan, read_plan
from clothkit.app.planner import decide
from clothkit.app.reach import check_limits, limits_of
from clothkit.app.settings import AppConfig, BallConfig
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import SQUARE
from clothkit.observation.waypoints import ReachConfig
from clothkit.planning.reach import Ball, Box, Limits, breaches
from clothkit.runtime.errors import InputError
from tests.app.conftest import AT, run, succeed
from tests.app.plans import finding
from tests.app.test_agent import metres
from tests.app.test_plan import toy_planner
from tests.planning import toy

START = centred(toy.bent())[0]
"""No turn leaves it as it is."""
ONE = np.array([[-1, -1, -1, -1, 0.7, 0.4]], np.float32)
BOTH = np.array([[-1, -1, -1, 1, 0.9, 0.0]], np.float32)
GOAL = np.asarray(toy.dragged(jnp.asarray(START), jnp.asarray(ONE[0])))
EVERYWHERE = Box((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))


@contextmanager
def decided(plan: np.ndarray) -> Iterator[None]:
    """A plan in place of what the first search finds; another search is one."""

    def found(*of: object, **how: object) -> object:
        with finding(plan):
            return decide(*of, **how)  # type: ignore[arg-type]

    with mock.patch.object(agent_state, "decide", found):
        yield


def an_agent(limits: Limits) -> Agent:
    """An agent in the toy world that has observed the cloth."""
    settings = load_settings(Path("data"))
    options = observation_options(settings.app, side=None, table=None)
    agent = Agent.of(toy_planner(), settings, options, limits=limits)
    agent.begin(metres(GOAL), steps=1)
    agent.observe(metres(START))
    return agent


def paths_of(plan: Plan) -> list[np.ndarray]:
    return [
        np.array([[point.position_m for point in hand.waypoints] for hand in step.hands]).reshape(
            len(step.hands), -1, 3
        )
        for step in plan.steps
    ]


def test_a_plan_in_reach_stays_and_hands_have_numbers_where_each_has_its_own(here: Path) -> None:
    left, right = Box((-9, -9, -9), (9, AT[1], 9)), Box((-9, AT[1], -9), (9, 9, 9))
    with decided(BOTH):
        for limits, numbers in (
            (Limits(), [None, None]),
            (Limits((EVERYWHERE,), apart=0.1), [None, None]),
            (Limits((left, right)), [0, 1]),
            (Limits((right, left)), [1, 0]),
        ):
            plan = an_agent(limits).plan()
            assert [hand.hand for hand in plan.steps[0].hands] == numbers
            np.testing.assert_allclose(plan.steps[0].manipulation, BOTH[0], atol=1e-6)
            assert plan.turned is None
    with decided(ONE):
        assert [hand.hand for hand in an_agent(Limits((right, left))).plan().steps[0].hands] == [1]


def test_another_plan_is_searched_for_where_turning_does_not_help(here: Path) -> None:
    """The known manipulation's arc leaves the box, or enters a zone; what is found instead keeps to the limits."""
    with decided(ONE):
        (free,) = paths_of(an_agent(Limits()).plan())
    ends = free[0, [0, -1]]
    for limits in (Limits((Box((-9, -9, -9), (ends[1, 0] - 0.02, 9, 9)),)),):
        assert breaches(limits, [free])
        with decided(ONE):
            agent = an_agent(limits)
            plan = agent.plan()
        assert breaches(limits, paths_of(plan)) == []
        assert plan.expected.improves
        assert not plan.steps[0].null
        # It is as near to the goal as the border lets it be, within what the search leaves to rounding.
        assert plan.expected.error_m < 0.5 * plan.expected.error_no_action_m  # type: ignore[operator]
        assert agent.state.planned is not None


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        (
            Limits((Box((5, 5, -1), (6, 6, 1)),)),
            r"a hand is \d.\d* m outside the box \(5, 5, -1\)..\(6, 6, 1\), and no .* within reach: they are \(",
        ),
        (
            Limits(keep_out=(Ball((*AT, 0.0), 1.0),)),
            r"inside the ball of radius 1 around .*, and no point that a plan may",
        ),
    ],
)
def test_a_cloth_that_is_out_of_reach_needs_no_search(here: Path, limits: Limits, says: str) -> None:
    with decided(ONE):
        agent = an_agent(limits)
        before = agent.state
        with pytest.raises(InputError, match=says):
            agent.plan()
    assert agent.state is before


def test_what_does_nothing_is_no_plan_within_reach(here: Path) -> None:
    null = np.array([[-1, -1, -1, -1, 0.1, 0.1]], np.float32)
    low = Box((-9, -9, -9), (9, 9, 0.01))
    with (
        decided(ONE),
        finding(null),
        pytest.raises(InputError, match="no plan was found that stays within reach and does"),
    ):
        an_agent(Limits((low,))).plan()
    # Nor is one that the search was not able to keep within.
    with (
        decided(ONE),
        finding(ONE),
        pytest.raises(InputError, match=r"in step 1 of the plan a hand is 0\.\d+ m outside"),
    ):
        an_agent(Limits((low,))).plan()


def test_the_command_takes_limits(here: Path) -> None:
    np.save(here / "start.npy", START)
    np.save(here / "goal.npy", GOAL)
    common = ("plan", "--state", "start.npy", "--goal", "goal.npy", "--steps", 1)
    side = ("--reach", -9, -9, -9, 9, 0, 9, "--reach-ball", 0, 9, 0, 9.1, "--apart", 0.01)
    with mock.patch.object(plan_command, "load_planner", return_value=toy_planner()), decided(BOTH):
        succeed(*common, *side)
        zone = run(*common, "--keep-out", -1, -1, -1, 1, 1, 1, "--out", "none.json")
        three = run(*common, *side, "--reach", 0, 0, 0, 1, 1, 1, "--out", "none.json")
    assert sorted(hand.hand for hand in read_plan(here / "plan.json").steps[0].hands) == [0, 1]
    assert "inside the box (-1, -1, -1)..(1, 1, 1)" in zone.stderr
    assert "--reach, --reach-ball: expected one for both hands or one for each, found 3" in three.stderr
    assert not (here / "none.json").exists()


def test_limits_come_from_options_and_else_from_settings() -> None:
    box = ReachConfig(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, 1.0))
    app = AppConfig(hands=(box, BallConfig(centre=(0.0, 0.0, 0.0), radius=2.0)), keep_out=(box,), apart=0.1)
    ours, ball = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), Ball((0.0, 0.0, 0.0), 2.0)
    assert limits_of(app) == Limits((ours, ball), (ours,), 0.1)
    assert limits_of(AppConfig(reach=box)) == Limits((ours,))
    assert limits_of(AppConfig()) == Limits()
    six = (0.0, 0.0, 0.0, 2.0, 2.0, 2.0)
    other = limits_of(app, boxes=[six], keep_out=[six], apart=0.0)
    assert other == Limits((Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0)),), (Box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0)),))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"boxes": [(0.0, 0.0, 0.0, -1.0, 1.0, 1.0)]}, "--reach: .*low corner first"),
        ({"balls": [(0.0, 0.0, 0.0, 0.0)]}, "--reach-ball: expected a centre and a radius above 0, found 0 0 0 0"),
        ({"keep_out": [(0.0, 0.0, np.nan, 1.0, 1.0, 1.0)]}, "--keep-out: expected six finite numbers"),
        ({"apart": -1.0}, "--apart: -1, expected metres, at least 0"),
    ],
)
def test_bad_limits_are_told_in_one_sentence(options: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        limits_of(AppConfig(), **options)  # type: ignore[arg-type]
    box = ReachConfig(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="reach and hands both say what the hands reach"):
        AppConfig(reach=box, hands=(box,))


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        (Limits((EVERYWHERE,) * 3), "limits: hands: expected one region for both hands or one for each, found 3"),
        (Limits((Box((0, 0, 0), (1, -1, 1)),)), r"hands: the box \(0, 0, 0\)..\(1, -1, 1\), expected the low corner"),
        (
            Limits(keep_out=(Ball((0, 0, 0), 0.0),)),
            "keep_out: the ball of radius 0 .*, expected a radius above 0",
        ),
        (Limits(keep_out=(Ball((0, np.nan, 0), 1.0),)), "limits: keep_out: .* has numbers that are none"),
        (Limits(apart=-0.1), "limits: apart: -0.1, expected metres, at least 0"),
    ],
)
def test_bad_limits_of_an_agent_are_told_in_one_sentence(limits: Limits, says: str) -> None:
    with pytest.raises(InputError, match=says):
        check_limits(limits)
    half = Limits((Box((0, -np.inf, -np.inf), (np.inf, np.inf, np.inf)),), apart=0.1)
    assert check_limits(half) is half


def test_the_goal_is_turned_where_the_turned_plan_nearly_fits(here: Path) -> None:
    """Turned by half, the known plan leaves the box by 5 mm: a plan for the turned goal is found within it."""
    flat = SQUARE.flat()
    goal = np.asarray(toy.dragged(jnp.asarray(flat), jnp.asarray(ONE[0])))
    settings = load_settings(Path("data"))
    options = observation_options(settings.app, side=None, table=None)

    def planned(limits: Limits) -> Plan:
        agent = Agent.of(toy_planner(), settings, options, limits=limits)
        agent.begin(metres(goal), steps=1)
        agent.observe(metres(flat))
        with decided(ONE):
            return agent.plan()

    (free,) = paths_of(planned(Limits()))
    turned = 2 * np.array(AT) - free[..., :2]
    low, high = turned.min((0, 1)) + np.array([0.005, -0.001]), turned.max((0, 1)) + 0.001
    limits = Limits((Box((*low, -9), (*high, 9)),))
    plan = planned(limits)
    np.testing.assert_allclose(np.array(plan.turned), -np.eye(2), atol=1e-6)
    assert breaches(limits, paths_of(plan)) == []
    assert plan.expected.error_m < 0.2 * plan.expected.error_no_action_m  # type: ignore[operator]
    assert plan.expected.error_without_limits_m is not None
    assert plan.limits is not None
    (region,) = plan.limits.hands
    assert region.low_m == pytest.approx((*low, -9))  # type: ignore[union-attr]
    assert "without them" in summary(plan, Path("plan.json"))


def test_a_turned_plan_is_remembered_as_it_is(here: Path) -> None:
    """A flat cloth looks the same turned: what is remembered is the turned plan, for the turned goal."""
    flat = SQUARE.flat()
    goal = np.asarray(toy.dragged(jnp.asarray(flat), jnp.asarray(ONE[0])))
    beyond = Box((AT[0] - 0.01, AT[1] - 0.01, -9), (9, 9, 9))
    settings = load_settings(Path("data"))
    agent = Agent.of(
        toy_planner(), settings, observation_options(settings.app, side=None, table=None), limits=Limits((beyond,))
    )
    agent.begin(metres(goal), steps=2)
    agent.observe(metres(flat))
    two = np.concatenate([ONE, [[1, 1, 1, 1, 0.1, 0.1]]]).astype(np.float32)
    with decided(two):
        plan = agent.plan()
    np.testing.assert_allclose(np.array(plan.turned), -np.eye(2), atol=1e-6)
    fold = jnp.asarray(plan.steps[0].manipulation, jnp.float32)
    outcome = np.mean([np.asarray(toy.dragged(jnp.asarray(flat), fold, net)) for net in toy.NETS], axis=0)
    agent.observe(metres(outcome), executed=True)
    memory = agent.state.memory
    np.testing.assert_allclose(memory.expected[0], outcome, atol=1e-4)
    np.testing.assert_allclose(memory.rest[0, 0], plan.steps[1].manipulation, atol=1e-6)
    np.testing.assert_allclose(memory.goal[0], centred(goal)[0] * np.float32([-1, -1, 1]), atol=1e-5)
    assert agent.observe(metres(outcome)).error == pytest.approx(0, abs=0.02)


def test_a_later_plan_that_is_turned_aims_at_the_turned_goal(here: Path) -> None:
    """From the second step on it is known under which labels the goal lies; turned, it lies under others."""
    flat = SQUARE.flat()
    goal = np.asarray(toy.dragged(jnp.asarray(flat), jnp.asarray(ONE[0])))
    settings = load_settings(Path("data"))
    options = observation_options(settings.app, side=None, table=None)
    beyond = Box((AT[0] - 0.01, AT[1] - 0.01, -9), (9, 9, 9))
    agent = Agent.of(toy_planner(), settings, options, limits=Limits((beyond,)))
    agent.begin(metres(goal), steps=2)
    agent.observe(metres(flat))
    # A plan that helps nothing is within reach, and its step is used up.
    with decided(np.float32([[1, 1, 1, 1, 0.2, 0.2], [1, 1, 1, 1, 0.1, 0.1]])):
        assert agent.plan().turned is None
    agent.observe(metres(flat))
    assert agent.left == 1
    with decided(ONE):
        assert agent.plan().turned is not None
    now = agent.state
    assert now.planned is not None
    wanted = now.planner.representation.relabel(now.memory.goal, now.memory.relative)
    away = float(now.planner.representation.distance(flat[None], wanted)[0])
    assert away == pytest.approx(now.planned.expected_no_action, abs=1e-4)


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        (Limits(hands=EVERYWHERE), "limits: hands: expected a tuple of regions, found a single one"),
        (Limits(keep_out=Ball((0, 0, 0), 0.1)), "limits: keep_out: expected a tuple of regions"),
        (Limits((Box((0, 0), (1, 1)),)), "limits: hands: .* expected corners and centres of three numbers"),
    ],
)
def test_limits_of_another_form_are_told(limits: Limits, says: str) -> None:
    with pytest.raises(InputError, match=says):
        check_limits(limits)

"""A session as the viewer plays it, in one form for recorded and live sessions.

All labels are those of the true states, so that a side of the cloth has the same colour everywhere; lengths are
normalised.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from clothkit.app.inputs import Settings
from clothkit.app.plan_file import UNLIKELY
from clothkit.app.planner import Planned, trusted_of
from clothkit.app.uncertainty import epistemic_uncertainty, measure_of
from clothkit.cloth.mesh import error
from clothkit.cloth.symmetry import relabel, relabel_manipulation
from clothkit.cloth.topology import CLOTH_LENGTH, PAPERS_CLOTH, SQUARE
from clothkit.evaluation.errors import labels_of_truth
from clothkit.manipulation.geometry import to_cartesian
from clothkit.models.ensemble import pairs
from clothkit.planning.planner import Planner
from clothkit.planning.uncertainty_terms import Measure

Mesh = Float[np.ndarray, "u v 3"]
State = Shaped[np.ndarray, "*state"]
"""A mesh [u v 3], or voxels [x y z] for a system that plans in voxels."""


_UNCERTAINTY: dict[Measure | None, str] = {
    "paper": "epistemic uncertainty u = {:.3g}",
    "conditional": "uncertainty term {:.3g} (measure conditional)",
    "support": "surprise of the manipulations {:.3g}",
    "expected": "the predicted outcome is expected to be off by {:.3f}",
    None: "uncertainty term {:.3g}, of a measure that the record does not name",
}


class StateEstimate(NamedTuple):
    """A system's estimate of the cloth, and its candidate grasp points."""

    state: State
    sigma: Mesh | None
    """Standard deviations of the estimate; None: not known."""
    candidates: Float[np.ndarray, "points 2"]
    """Grasp points in the nets' input coordinates: geodesic for meshes, Cartesian for voxels."""


class ShownPlan(NamedTuple):
    """A plan for the m manipulations that are left, and each net's predictions for it."""

    manipulations: Float[np.ndarray, "m 6"]
    members: tuple[int, ...]
    """The members of the ensemble whose nets predict."""
    means: Shaped[np.ndarray, "net m *state"]
    sigmas: Float[np.ndarray, "net m u v 3"] | None
    uncertainty: float | None
    """The uncertainty term that the search weighed, in the unit of its measure; None: none, or not known."""
    loss: float
    progress: Float[np.ndarray, " evaluations"]
    """The lowest loss up to each iteration of the search."""
    tried: int
    """Number of plans that each iteration evaluates."""
    improves: bool
    """Whether the plan is expected to improve the state, as the agent decided."""
    expected: float | None = None
    """Distance of the nets' mean predicted outcome from the goal in the labelling that was found [cloth length]; None
    for voxels."""
    expected_no_action: float | None = None
    """The same of the estimated state."""
    outcome_error: tuple[float, float, float] | None = None
    """What such plans came to, and the bounds of 80 % of them [cloth length]; None: not known."""
    trust: float | None = None
    """The share of such plans that came true."""
    note: str = ""
    """What happened to the plan, in words."""
    measure: Measure | None = "paper"
    """What `uncertainty` measures; None: not known."""


class Step(NamedTuple):
    """One state of a session: the system's estimate of it, and the plan from it, if there is one yet."""

    estimate: StateEstimate
    plan: ShownPlan | None = None


class Session(NamedTuple):
    """A session of `length` manipulations, of which some may still be missing."""

    title: str
    length: int
    goal: State
    states: tuple[Mesh, ...]
    """The true states, centred."""
    steps: tuple[Step, ...]
    """One for each state except the outcome."""
    centres: tuple[Float[np.ndarray, "2"], ...] = ()
    """Where the centre of each state lies on the table [normalised]; empty: not known."""
    cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH
    """Sides and thickness of the cloth [normalised]."""

    @property
    def over(self) -> bool:
        """Whether the last state is the outcome."""
        return len(self.states) > self.length


def shown_plan(
    planner: Planner,
    planned: Planned,
    *,
    progress: Float[np.ndarray, " evaluations"] | None = None,
    tried: int = 0,
    settings: Settings | None = None,
) -> ShownPlan:
    """Return a plan as it is shown, with the progress of its search if that is known.

    With `settings`, it is told how far such plans can be trusted, if that is known.
    """
    told = None if settings is None else trusted_of(planned, settings, planner.system)
    measure = measure_of(planner)
    return ShownPlan(
        manipulations=planned.plan,
        members=planner.members,
        means=planned.means,
        sigmas=planned.stds,
        uncertainty=epistemic_uncertainty(planner, planned) if measure == "paper" else planned.prediction_error,
        loss=planned.loss,
        progress=np.zeros(0, np.float32) if progress is None else progress,
        tried=tried,
        improves=planned.improves,
        expected=None if planner.system.voxels else planned.expected,
        expected_no_action=None if planner.system.voxels else planned.expected_no_action,
        outcome_error=None if told is None else (float(told.error[0]), float(told.low[0]), float(told.high[0])),
        trust=None if told is None else float(told.trust[0]),
        measure=measure,
    )


def is_mesh(state: np.ndarray) -> bool:
    """Whether a state is a mesh, and not voxels."""
    return state.shape == (*SQUARE.shape, 3)


def matched(step: Step, truth: Mesh, cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH) -> Step:
    """Relabel a step so that its estimate is nearest to the true state. Voxels have no labels and stay as they are.

    Only labels that a cloth of these sides can have are given to it.
    """
    estimate, plan = step
    if not is_mesh(estimate.state):
        return step
    k = int(labels_of_truth(estimate.state[None].astype(np.float32), truth[None], cloth=cloth[None])[0])
    # Candidates are grasp points, and are relabelled as those of a manipulation.
    points = np.concatenate([np.tile(estimate.candidates, 2), np.zeros_like(estimate.candidates)], axis=1)
    candidates = np.asarray(relabel_manipulation(points, k))[:, :2]
    sigma = None if estimate.sigma is None else _relabelled(estimate.sigma, k)
    estimate = StateEstimate(_relabelled(estimate.state, k), sigma, candidates)
    if plan is not None:
        plan = plan._replace(
            manipulations=np.asarray(relabel_manipulation(plan.manipulations, k)),
            means=_relabelled(plan.means, k),
            sigmas=None if plan.sigmas is None else _relabelled(plan.sigmas, k),
        )
    return Step(estimate, plan)


def _relabelled(mesh: np.ndarray, k: int) -> np.ndarray:
    return np.asarray(relabel(mesh.astype(np.float32), k))


def places(state: State, grasps: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
    """Return the positions of grasp points on a state, xy [normalised]."""
    if not is_mesh(state) or not len(grasps):
        return grasps
    return np.asarray(to_cartesian(np.broadcast_to(state, (len(grasps), *state.shape)), grasps))[:, :2]


def error_of(
    state: State, goal: Shaped[np.ndarray, "*goal"], cloth: Float[np.ndarray, "3"] = PAPERS_CLOTH
) -> float | None:
    """Return a state's error against a goal [cloth length], aligned, in the labels that suit best.

    None unless both are meshes. `cloth` has the sides of both.
    """
    if not is_mesh(state) or not is_mesh(goal):
        return None
    return float(error(state.astype(np.float32), goal.astype(np.float32), aligned=True, cloth=cloth))


def facts(session: Session, at: int) -> str:
    """Return the facts about a session at state `at`, as Markdown, with errors in cloth lengths."""
    now, start = (error_of(session.states[i], session.goal, session.cloth) for i in (at, 0))
    lines = [f"**{session.title}**", ""]
    many = f"{session.length} manipulation{'' if session.length == 1 else 's'}"
    lines.append(
        f"- outcome after {many}" if at == session.length else f"- before manipulation {at + 1} of {session.length}"
    )
    if now is not None and start is not None:
        lines.append(f"- error **{now:.3f}** ({start:.3f} if nothing had been done)" if at else f"- error {now:.3f}")
    if at < len(session.steps):
        lines += _facts_of(session.steps[at].plan)
    return "\n".join(lines)


def _facts_of(plan: ShownPlan | None) -> list[str]:
    if plan is None:
        return ["- no plan yet"]
    lines = []
    if plan.expected is not None and plan.expected_no_action is not None:
        lines.append(
            f"- expected error **{plan.expected:.3f}** after the plan, {plan.expected_no_action:.3f} if nothing is done"
        )
    if plan.outcome_error is not None and plan.trust is not None:
        error, low, high = plan.outcome_error
        ended = f"such plans ended at {error:.3f}, 80 % of them at {low:.3f} to {high:.3f}"
        lines.append(f"- {ended}; trust **{plan.trust:.2f}**")
    if plan.uncertainty is not None:
        lines.append(f"- {_UNCERTAINTY[plan.measure].format(plan.uncertainty)}")
    apart = disagreement(plan)
    if apart is not None:
        by = ", ".join(f"{after.mean():.3f}" for after in apart / CLOTH_LENGTH)
        lines.append(f"- the nets differ by {by} after each manipulation")
    lines.append(f"- loss {plan.loss:.3g}")
    if not plan.improves:
        lines.append(f"- ⚠ **{UNLIKELY}**")
    if plan.note:
        lines.append(f"- {plan.note}")
    return lines


def disagreement(plan: ShownPlan) -> Float[np.ndarray, "m u v"] | None:
    """Return the distance between the nets' predictions of each vertex, by manipulation; None for one net or voxels.

    With more than two nets it is the mean over all pairs of them.
    """
    if len(plan.means) < 2 or not is_mesh(plan.means[0, 0]):
        return None
    return np.mean([np.linalg.norm(a - b, axis=-1) for a, b in pairs(list(plan.means))], axis=0)

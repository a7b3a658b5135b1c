"""A session as the viewer plays it, the same whether it was recorded or is being made.

All labels are those of the true states, so that sides match in colour; lengths are normalised.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from clothkit.app.plan_file import UNLIKELY
from clothkit.cloth.equivalents import relabel, relabel_manipulation
from clothkit.cloth.grid import CLOTH_SIDE, SIDE
from clothkit.cloth.mesh import error
from clothkit.evaluation.errors import labels_of_truth
from clothkit.manipulation.geometry import to_cartesian
from clothkit.manipulation.vector import is_null

Mesh = Float[np.ndarray, "u v 3"]
Believed = Shaped[np.ndarray, "*state"]
"""A mesh [u v 3], or voxels [x y z] of a system that sees these."""


class Look(NamedTuple):
    """What a system takes the cloth for."""

    estimate: Believed
    sigma: Mesh | None
    """Standard deviations of the estimate, where they are known."""
    candidates: Float[np.ndarray, "points 2"]
    """Grasp points as the nets take them: geodesic, or Cartesian in voxels."""


class ShownPlan(NamedTuple):
    """A plan for the m manipulations that are left, and what each of the nets expects of it."""

    manipulations: Float[np.ndarray, "m 6"]
    means: Shaped[np.ndarray, "net m *state"]
    sigmas: Float[np.ndarray, "net m u v 3"] | None
    uncertainty: float | None
    """u of eq. (15); None for one net alone."""
    loss: float
    progress: Float[np.ndarray, " evaluations"]
    """The lowest loss so far, for each iteration of the search."""
    tried: int
    """Plans that each of these iterations has tried."""
    note: str = ""
    """What became of it, in words."""


class Step(NamedTuple):
    """A state of a session: what it was taken for and what was planned from it, if anything was."""

    look: Look
    plan: ShownPlan | None = None


class Session(NamedTuple):
    """A session of `length` manipulations, as far as it has come."""

    title: str
    length: int
    goal: Believed
    states: tuple[Mesh, ...]
    """What the cloth really was, centred."""
    steps: tuple[Step, ...]
    """One for each state but the outcome."""

    @property
    def over(self) -> bool:
        """Whether the last state is the outcome."""
        return len(self.states) > self.length


def is_mesh(state: np.ndarray) -> bool:
    """Whether a state is a mesh, and not voxels."""
    return state.shape == (SIDE, SIDE, 3)


def matched(step: Step, truth: Mesh) -> Step:
    """The step under the labels in which its estimate comes nearest to the true state; voxels have none."""
    look, plan = step
    if not is_mesh(look.estimate):
        return step
    k = int(labels_of_truth(look.estimate[None].astype(np.float32), truth[None])[0])
    # A candidate is a manipulation's grasp point, relabelled like it.
    points = np.concatenate([np.tile(look.candidates, 2), np.zeros_like(look.candidates)], axis=1)
    candidates = np.asarray(relabel_manipulation(points, k))[:, :2]
    look = Look(_relabelled(look.estimate, k), None if look.sigma is None else _relabelled(look.sigma, k), candidates)
    if plan is not None:
        plan = plan._replace(
            manipulations=np.asarray(relabel_manipulation(plan.manipulations, k)),
            means=_relabelled(plan.means, k),
            sigmas=None if plan.sigmas is None else _relabelled(plan.sigmas, k),
        )
    return Step(look, plan)


def _relabelled(mesh: np.ndarray, k: int) -> np.ndarray:
    return np.asarray(relabel(mesh.astype(np.float32), k))


def places(state: Believed, grasps: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
    """Where grasp points lie on a state, xy."""
    if not is_mesh(state) or not len(grasps):
        return grasps
    return np.asarray(to_cartesian(np.broadcast_to(state, (len(grasps), *state.shape)), grasps))[:, :2]


def error_of(state: Believed, goal: Shaped[np.ndarray, "*goal"]) -> float | None:
    """How far a state is from a goal [cloth length, aligned, whatever the labels]; None unless both are meshes."""
    if not is_mesh(state) or not is_mesh(goal):
        return None
    return float(error(state.astype(np.float32), goal.astype(np.float32), aligned=True))


def facts(session: Session, at: int) -> str:
    """What there is to tell of a session's state `at`, as Markdown. Errors in cloth lengths."""
    now, start = (error_of(session.states[i], session.goal) for i in (at, 0))
    lines = [f"**{session.title}**", ""]
    many = f"{session.length} manipulation{'' if session.length == 1 else 's'}"
    lines.append(
        f"- outcome after {many}" if at == session.length else f"- before manipulation {at + 1} of {session.length}"
    )
    if now is not None and start is not None:
        lines.append(f"- error **{now:.3f}** ({start:.3f} if nothing had been done)" if at else f"- error {now:.3f}")
    if at < len(session.steps):
        lines += _facts_of(session.steps[at], session.goal)
    return "\n".join(lines)


def _facts_of(step: Step, goal: Believed) -> list[str]:
    plan = step.plan
    if plan is None:
        return ["- no plan yet"]
    lines = []
    expected, still = expectation(step, goal)
    if expected is not None and still is not None:
        lines.append(f"- expected error **{expected:.3f}** after the plan, {still:.3f} if nothing is done")
    if plan.uncertainty is not None:
        lines.append(f"- epistemic uncertainty u = {plan.uncertainty:.3g}")
    apart = disagreement(plan)
    if apart is not None:
        by = ", ".join(f"{after.mean():.3f}" for after in apart / CLOTH_SIDE)
        lines.append(f"- the nets differ by {by} after each manipulation")
    lines.append(f"- loss {plan.loss:.3g}")
    if unlikely(step, goal):
        lines.append(f"- ⚠ **{UNLIKELY}**")
    if plan.note:
        lines.append(f"- {plan.note}")
    return lines


def expectation(step: Step, goal: Believed) -> tuple[float | None, float | None]:
    """The errors that the mean of the nets' predictions comes to, and that of the estimate as it is."""
    if step.plan is None or not len(step.plan.means):
        return None, None
    return error_of(step.plan.means[:, -1].mean(0), goal), error_of(step.look.estimate, goal)


def unlikely(step: Step, goal: Believed) -> bool:
    """Whether a plan is not expected to improve the state."""
    if step.plan is None:
        return False
    if all(bool(is_null(manipulation)) for manipulation in step.plan.manipulations):
        return True
    expected, still = expectation(step, goal)
    return expected is not None and still is not None and expected >= still


def disagreement(plan: ShownPlan) -> Float[np.ndarray, "m u v"] | None:
    """How far apart the nets' predictions of each vertex are after each manipulation; None for one net or voxels."""
    if len(plan.means) < 2 or not is_mesh(plan.means[0, 0]):
        return None
    return np.linalg.norm(plan.means[0] - plan.means[1], axis=-1)

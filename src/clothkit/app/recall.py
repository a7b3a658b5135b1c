"""What a plan file says, as planning takes it: normalised, centred, as arrays."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothkit.app.plan_file import MeshState, Placed, Plan
from clothkit.app.planner import Believed, Past, Planned, Traces, first_traces, traces_after
from clothkit.errors import InputError
from clothkit.planning.planner import Planner, artifacts
from clothkit.planning.systems import better_net

_SAME = 1e-6
"""By what share two sides may differ that are the same."""


def manipulations(plan: Plan) -> Float[np.ndarray, "n 6"]:
    """The plan as nets take it."""
    return np.array([step.manipulation for step in plan.steps], np.float32)


def believed_of(plan: Plan, placed: Placed) -> Believed:
    """A state of a plan."""
    if not isinstance(placed.state, MeshState):
        occupancy = np.array(placed.state.occupancy, np.float32)
        return occupancy > 0 if np.isin(occupancy, (0, 1)).all() else occupancy
    pose = plan.pose(placed.centre_m)
    return pose.camera_to_normalised(np.array(placed.state.vertices_m, float)).astype(np.float32)


def side_of(plan: Plan, side: float | None, name: Path) -> float:
    """The cloth's side [m]: a plan's own. Raises InputError when another one is asked for."""
    if side is not None and abs(side / plan.side_m - 1) > _SAME:
        raise InputError(f"--side: expected {plan.side_m:g}, for which {name} was planned, found {side:g}")
    return plan.side_m


def check_nets(plan: Plan, planner: Planner, data: Path, name: Path) -> None:
    """That a plan was made with the nets that there are. Raises InputError."""
    folders = artifacts(planner.system, data)
    better = better_net({net: folders[net] for net in ("a", "b")})
    found = plan.steps[0].predictions[plan.memory.better].net
    if found != better:
        raise InputError(
            f"{name}: memory.better: is net {found}, but of the nets in {data} net {better} is better; was it planned "
            "with other nets?"
        )


def traces_before(plan: Plan, planner: Planner, name: Path) -> Traces:
    """The memory traces before a plan. Raises InputError when they are not of the planner's nets."""
    first = first_traces(planner)
    if plan.memory.traces_before is None:
        return first
    found = tuple(np.array(trace, np.float32) for trace in plan.memory.traces_before)
    if [trace.shape for trace in found] != [trace.shape for trace in first]:
        raise InputError(
            f"{name}: memory.traces_before: has shapes {[trace.shape for trace in found]}, the nets expect "
            f"{[trace.shape for trace in first]}; was it planned with other nets?"
        )
    return found


def past_of(plan: Plan, planner: Planner, name: Path) -> Past:
    """What an executed first step leaves to the next plan (section 5.1). Raises InputError when nothing is left to do.

    A null manipulation is not executed: state and traces carry over.
    """
    if len(plan.steps) < 2:
        raise InputError(f"{name}: has one step, so nothing is left to plan after it; plan afresh, without --after")
    start, traces, later = believed_of(plan, plan.start), traces_before(plan, planner, name), manipulations(plan)
    first = plan.steps[0]
    if first.null:
        return Past(start, traces, plan.memory.relative, later[1:])
    placed = Placed(state=first.predictions[plan.memory.better].state, centre_m=first.centre_m)
    done = Planned(start, later, plan.memory.common, plan.memory.relative, (), np.zeros((0, 2)), traces)
    return Past(believed_of(plan, placed), traces_after(planner, done), plan.memory.relative, later[1:])

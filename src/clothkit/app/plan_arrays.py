"""Convert the content of a plan file to the inputs of planning: arrays, normalised and centred."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothkit.app.plan_file import Plan
from clothkit.app.plan_parts import MeshState, Placed
from clothkit.app.planner import State, Traces, memory_after
from clothkit.planning.agent import initial_traces
from clothkit.planning.planner import Planner
from clothkit.planning.plans import expectation
from clothkit.planning.types import Memory
from clothkit.runtime.errors import InputError

_SAME = 1e-6
"""Relative difference up to which two sides count as equal."""


def manipulations(plan: Plan) -> Float[np.ndarray, "n 6"]:
    """Return the plan's manipulations as one array, the input of the nets."""
    return np.array([step.manipulation for step in plan.steps], np.float32)


def placed_state(plan: Plan, placed: Placed) -> State:
    """Return a state of a plan: a mesh, or voxels (boolean if each is 0 or 1, else probabilities)."""
    if not isinstance(placed.state, MeshState):
        occupancy = np.array(placed.state.occupancy, np.float32)
        return occupancy > 0 if np.isin(occupancy, (0, 1)).all() else occupancy
    pose = plan.pose(placed.centre_m)
    return pose.camera_to_normalised(np.array(placed.state.vertices_m, float)).astype(np.float32)


def cloth_of(plan: Plan, values: dict[str, Any], name: Path) -> dict[str, Any]:
    """Return the options `side`, `sides` and `thickness` of the cloth that a plan was made for.

    `values` are the options that were given. Raises InputError if one of them differs.
    """
    sides, thickness = plan.sides_m or (plan.side_m, plan.side_m), plan.thickness_m
    of_plan = {"side": (plan.side_m,), "sides": sides, "thickness": None if thickness is None else (thickness,)}
    for option, planned in of_plan.items():
        if (given := values.get(option)) is None or planned is None:
            continue
        found = sorted(given) if isinstance(given, tuple) else [given]
        if not np.allclose(found, sorted(planned), rtol=_SAME, atol=0):
            wanted, told = (" x ".join(f"{v:g}" for v in numbers) for numbers in (planned, found))
            raise InputError(f"--{option}: expected {wanted}, for which {name} was planned, found {told}")
    return {"side": None, "sides": sides, "thickness": values.get("thickness") if thickness is None else thickness}


def check_nets(plan: Plan, planner: Planner, data: Path, name: Path) -> None:
    """Check that a plan's nets are those of a planner, whose nets come from `data`. Raises InputError."""
    nets = tuple(prediction.net for prediction in plan.steps[0].predictions)
    if nets != planner.members and not planner.system.single:
        expected, found = (", ".join(map(str, names)) for names in (planner.members, nets))
        raise InputError(f"{name}: was planned with nets {found}, expected {expected}, the ensemble's members")
    best = planner.members[planner.best]
    if nets[plan.memory.best] != best:
        raise InputError(
            f"{name}: memory.best: is net {nets[plan.memory.best]}, but of the nets in {data} net {best} is the best; "
            "was it planned with other nets?"
        )


def traces_before(plan: Plan, planner: Planner, name: Path) -> Traces:
    """Return the memory traces before a plan. Raises InputError when their shapes don't fit the planner's nets."""
    first = tuple(trace[0] for trace in initial_traces(planner, 1))
    if plan.memory.traces_before is None:
        return first
    found = tuple(np.array(trace, np.float32) for trace in plan.memory.traces_before)
    if [trace.shape for trace in found] != [trace.shape for trace in first]:
        raise InputError(
            f"{name}: memory.traces_before: has shapes {[trace.shape for trace in found]}, the nets expect "
            f"{[trace.shape for trace in first]}; was it planned with other nets?"
        )
    return found


def steps_left(plan: Plan, name: Path, steps: int | None = None) -> int:
    """The number of manipulations that are left of a plan after its first step.

    Raises InputError if none is, or if there are not `steps`.
    """
    left = len(plan.steps) - 1
    if not left:
        raise InputError(f"{name}: has one step, so nothing is left to plan after it; plan afresh, without --after")
    if steps not in (None, left):
        raise InputError(f"--steps: expected {left}, what is left of {name}, found {steps}")
    return left


def memory_of(plan: Plan, planner: Planner, blank: Memory, traces: Traces, left: int) -> Memory:
    """Return what the next decision needs after a plan's first step (section 5.1), as a batch of one.

    `blank` is the memory before a first decision, with the goal, `traces` are those before the plan, and `left` is how
    many manipulations are left. A null manipulation is not executed.
    """
    first, predicted = plan.steps[0], None
    if not first.null:
        each = [prediction.state for prediction in first.predictions]
        means = np.stack([placed_state(plan, Placed(state=state, centre_m=first.centre_m)) for state in each])
        stds = [state.sigma_m for state in each if isinstance(state, MeshState) and state.sigma_m is not None]
        scale = plan.metres_per_normalised
        predicted = expectation(means, np.array(stds, np.float32) / scale if len(stds) == len(each) else None)
    return memory_after(
        planner,
        blank,
        placed_state(plan, plan.start),
        manipulations(plan),
        common=plan.memory.common,
        relative=plan.memory.relative,
        traces=traces,
        predicted=predicted,
        left=left,
    )

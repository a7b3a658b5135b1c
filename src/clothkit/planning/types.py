"""What planning takes and gives: observations, problems, plans and memories, as immutable pytrees.

In a batch, every array has a leading axis of tasks. States have the shape `*state` of the planner's representation: a
mesh [u v 3], normalised and centred, or voxels [x y z].
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from clothkit.cloth.topology import PAPERS_CLOTH

Scalar = float | int | np.float32 | Float[Array, ""]

States = Shaped[np.ndarray, "task *state"]
Meshes = Float[np.ndarray, "task u v 3"]
Traces = tuple[Float[np.ndarray, "task labels latent"], ...]
"""For each net, the memory traces for all common equivalents of the state."""

UNKNOWN = -1
"""Marks a relative labelling that is not fixed: each evaluation of the loss then uses the one that fits best."""


class Observation(NamedTuple):
    """What is known of a batch of cloths before any estimation, centred; a perception uses one of the two."""

    voxels: Bool[np.ndarray, "task x y z"] | None = None
    """Occluded voxels, as a camera above the table sees them."""
    meshes: Meshes | None = None
    """The meshes themselves, where they are known."""


class Candidates(NamedTuple):
    """Grasp points of one state, padded to a fixed number so that all tasks have the same shapes.

    The first `present` rows of `grasps` are candidates, the rest is padding.
    """

    grasps: Float[Array, "candidates 2"] | Float[np.ndarray, "candidates 2"]
    present: Int[Array, ""] | Int[np.ndarray, ""] | int


class Problem(NamedTuple):
    """The inputs of one search.

    `state` is the initial state of the plan, as the system observes it: an estimate, a true mesh or voxels. The
    candidates, `carried`, `traces` and `relative` refer to its labels.
    """

    state: Shaped[Array | np.ndarray, "*state"]
    goal: Shaped[Array | np.ndarray, "*state"]
    candidates: Candidates
    traces: tuple[Float[Array | np.ndarray, "labels latent"], ...]
    """For each net, the memory traces for all common equivalents of the state."""
    relative: Int[Array | np.ndarray, ""]
    """Index of the relabelling that brings the goal to the state's labels, or `UNKNOWN`."""
    later: Bool[Array | np.ndarray, ""]
    """Whether this is a later search of a session, with the rest of the previous plan in `carried`. If so, the strains
    are divided evenly among the common equivalents, and one strain of each starts from `carried`."""
    carried: Float[Array | np.ndarray, "n 6"]
    cloth: Float[Array | np.ndarray, "3"] | np.ndarray = PAPERS_CLOTH
    """Sides and thickness of the cloth, in the labels of `state` [normalised]."""
    covered: Bool[Array | np.ndarray, "x y"] | None = None
    """Mask of the area that the cloth covers, as `initial.folds` takes it; required if `fold` is set."""


class Found(NamedTuple):
    """The result of a search: the plan of lowest loss, in the labels of the initial state."""

    plan: Float[Array, "n 6"]
    loss: Float[Array, ""]
    terms: dict[str, Float[Array, "..."]]
    """The terms of the loss by name, without their weights; `accuracy` has a value per net."""
    common: Int[Array, ""]
    """Index of the common equivalent in which the plan was found."""
    relative: Int[Array, ""]
    """Index of the goal's relabelling that the loss of the plan refers to."""
    losses: Float[Array, "iterations strains"]


class Choice(NamedTuple):
    """How the number of manipulations was chosen, for each task of a batch (section 8)."""

    length: Int[np.ndarray, " task"]
    """The number of manipulations; 0: nothing more is expected to improve the state, and the session is over."""
    expected: Float[np.ndarray, "task length"]
    """Expected distance from the goal after none, one, two, .. manipulations, in the measure of the null check;
    infinite where no such plan was found or allowed."""


class Plan(NamedTuple):
    """A plan for each task of a batch, from the state as the planner knows it, in that state's labels.

    Steps after a plan's end are NaN. A plan has at most `dataset.store.STEPS` manipulations.
    """

    state: States
    candidates: Float[np.ndarray, "task candidate 2"]
    """Candidate grasp points on the state, NaN where there are fewer."""
    length: Int[np.ndarray, " task"]
    manipulations: Float[np.ndarray, "task planned 6"]
    loss: Float[np.ndarray, " task"]
    terms: dict[str, Float[np.ndarray, "task *net"]]
    """The terms of the loss by name, as in `Found`."""
    common: Int[np.ndarray, " task"]
    """Index of the common equivalent in which the plan was found."""
    relative: Int[np.ndarray, " task"]
    """Index of the relabelling that brings the goal to the state's labels."""
    means: Float[np.ndarray, "task planned net *state"]
    """The means of each net's prediction after each manipulation; for voxels, the predicted occupancy 0..1."""
    stds: Float[np.ndarray, "task planned net *state"] | None
    """The standard deviations of the predictions; None for voxels."""
    shifts: Float[np.ndarray, "task planned net 2"]
    """Each net's predicted shift of the cloth's centre by each manipulation [normalised]."""
    traces: Traces
    """The memory traces after the plan's first manipulation."""
    differences: Float[np.ndarray, "task planned"] | None
    """How far the nets' predictions are apart after each manipulation, diff of eq. (15); None for a single net."""
    expected: Float[np.ndarray, " task"]
    """Distance of the mean predicted outcome from the goal, in the measure of the null check."""
    useless: Bool[np.ndarray, " task"]
    """Whether the plan is not expected to bring the state nearer to its goal (the null check of section 5.1)."""
    null: Bool[np.ndarray, " task"]
    """Whether the plan's first manipulation shall not be executed: the plan is useless, or the manipulation null."""
    progress: Float[np.ndarray, "task iteration"]
    """The lowest loss of all strains up to each iteration of the search, as the optimiser evaluates it: not exact."""
    tried: Int[np.ndarray, " task"]
    """Number of plans that the search evaluates in an iteration."""
    choice: Choice | None = None
    """How the number of manipulations was chosen; None: it was told. A plan of none is one null manipulation."""


class Memory(NamedTuple):
    """What an agent keeps of each task from one decision to the next (section 5.1)."""

    goal: States
    cloth: Float[np.ndarray, "task 3"]
    """Sides along u and v and thickness of each cloth, in the labels of states and goal [normalised]."""
    left: Int[np.ndarray, " task"]
    """Number of manipulations that are left; of an agent that chooses their number, that are left at most."""
    planned: Bool[np.ndarray, " task"]
    """Whether a plan was made before; if not, the fields below mean nothing but the traces, which are zero."""
    still: Bool[np.ndarray, " task"]
    """Whether the last plan's first manipulation was not executed, so that the cloth lies as it lay."""
    state: States
    """The state that the last plan starts from."""
    candidates: Float[np.ndarray, "task candidate 2"]
    relative: Int[np.ndarray, " task"]
    rest: Float[np.ndarray, "task planned 6"]
    """The manipulations of the last plan after its first."""
    expected: States
    """The nets' mean prediction of the state after the last executed manipulation."""
    unsure: States
    """The standard deviations of `expected`, with what the nets differ by; infinite where none are known."""
    traces: Traces

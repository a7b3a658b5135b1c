"""Representations: what states a planner plans in, how they are labelled, compared and grasped (section 5.1).

`MESH` (mesh_representation.py) and `VOXEL` (voxel_representation.py) are the two of section 6.3. A representation knows
nothing of a net's weights, and nothing of how a state was observed.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from clothkit.manipulation.candidates import CandidateConfig
from clothkit.planning.types import Meshes, States


class Recorded(NamedTuple):
    """Recorded manipulations as a net's input, with the states before the first and after the last manipulation."""

    start: Shaped[np.ndarray, "task *state"]
    plan: Float[np.ndarray, "task n 6"]
    goal: Shaped[np.ndarray, "task *state"]


@runtime_checkable
class Representation(Protocol):
    """The states, of shape `*state`, of a planner and of its forward models; a prediction is what a model decodes.

    The methods for one state take JAX arrays and may be traced; those for a batch of tasks take NumPy arrays, and so do
    the ones that describe the area of a cloth. Objects are hashable and equal if they compute the same.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one state."""
        ...

    @property
    def labels(self) -> int:
        """The number of labellings of one state: eight equivalents, or one if states have no labels."""
        ...

    @property
    def probabilistic(self) -> bool:
        """Whether predictions are probabilistic meshes, and not the logits of voxels."""
        ...

    def equivalents(self, state: Shaped[Array, "*state"]) -> Shaped[Array, "labels *state"]:
        """The state under all labellings, in order of their index k."""
        ...

    def relabel_prediction(self, prediction: Any, k: Int[Array, ""]) -> Any:
        """A prediction under the labels of equivalent k."""
        ...

    def points(
        self, state: Shaped[Array | np.ndarray, "*state"], grasps: Float[Array, "*points 2"]
    ) -> Float[Array, "*points 2"]:
        """The positions xy [normalised] of grasp points, which are in the coordinates of the nets' inputs."""
        ...

    def target(self, goals: Shaped[Array, "..."]) -> Float[Array, "..."]:
        """Goals, thinned or not, in the form that `accuracy` takes."""
        ...

    def thinned(self, goals: Shaped[Array, "..."], stride: int) -> Shaped[Array, "..."]:
        """The part of the goals that predictions decoded with that stride are compared with."""
        ...

    def accuracy(self, target: Float[Array, "..."], outcome: Any) -> Float[Array, "*batch"]:
        """How unlike predicted outcomes are to targets: the NLL of eq. (13), or what stands for it."""
        ...

    def accuracy_of_each(self, targets: Float[Array, "goals *state"], outcome: Any) -> Float[Array, "strains goals"]:
        """`accuracy` of every outcome of a batch for every one of several targets."""
        ...

    def difference(self, a: Any, b: Any) -> Float[Array, "*batch"]:
        """diff of eq. (15): how far two nets' predictions are apart."""
        ...

    def relabel(self, states: States, k: Int[np.ndarray, " task"]) -> States:
        """The states of a batch, each under the labels of its equivalent k."""
        ...

    def positions(self, states: States, grasps: Float[np.ndarray, "task 2 2"]) -> Float[np.ndarray, "task 2 2"]:
        """`points` for a batch of states, two grasp points each."""
        ...

    def mean(self, prediction: Any) -> Shaped[np.ndarray, "..."]:
        """The means of predictions, without their standard deviations; for voxels, the predicted occupancy 0..1."""
        ...

    def std(self, prediction: Any) -> Float[np.ndarray, "..."] | None:
        """The standard deviations of predictions; None where there are none."""
        ...

    def distance(self, states: States, goals: States) -> Float[np.ndarray, " task"]:
        """Distance of each state from its goal under the goal's labels, for the null check (section 5.1).

        For meshes it is aligned [cloth length], for voxels it is the mean absolute difference.
        """
        ...

    def of_meshes(self, meshes: Meshes) -> States:
        """Meshes converted to this representation; goals are meshes at first."""
        ...

    def recorded(self, states: Float[np.ndarray, "task state u v 3"], plan: Float[np.ndarray, "task n 6"]) -> Recorded:
        """Recorded manipulations as inputs of the nets, in the dataset's labels."""
        ...

    def candidates(
        self, state: Shaped[np.ndarray, "*state"], settings: CandidateConfig
    ) -> Float[np.ndarray, "candidates 2"]:
        """Candidate grasp points on one state, in the coordinates of the nets' inputs (section 4.3)."""
        ...

    def covered(self, state: Shaped[np.ndarray, "*state"]) -> Bool[np.ndarray, "x y"]:
        """Mask of the area that one state covers, seen from above, as `initial.folds` takes it."""
        ...

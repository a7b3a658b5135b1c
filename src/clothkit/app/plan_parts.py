"""The parts of a plan file, as types that refuse impossible values; `plan_file` puts them together."""

import math
from typing import Annotated, Literal

import pydantic
from annotated_types import Ge, Gt, Le, Len

from clothkit.app.inputs import Kind, Usage
from clothkit.app.options import WITHIN
from clothkit.app.plan_checks import check_axes, check_hand, check_step, check_unsure
from clothkit.app.unsure import PartName
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import RESOLUTION

MOST_NETS = 64
"""Limit of the number of nets."""

LONGEST = 8.0
"""Limit of a displacement along x or y [normalised]. A search starts at 2.6 or less, and moves by 0.05 an iteration."""

Coordinate = Annotated[float, Ge(-WITHIN), Le(WITHIN)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Direction = tuple[float, float, float]
Geodesic = Annotated[float, Ge(-1), Le(1)]
Displacement = Annotated[float, Ge(-LONGEST), Le(LONGEST)]
NotNegative = Annotated[float, Ge(0)]
_Unit = Annotated[float, Ge(-1e6), Le(1e6)]
Share = Annotated[float, Ge(0), Le(1)]
_U, _V = SQUARE.shape
Grid = Annotated[list[Annotated[list[Point], Len(_V, _V)]], Len(_U, _U)]
_Deviation = tuple[NotNegative, NotNegative, NotNegative]
Deviations = Annotated[list[Annotated[list[_Deviation], Len(_V, _V)]], Len(_U, _U)]
_Column = Annotated[list[Share], Len(RESOLUTION[2], RESOLUTION[2])]
Occupancy = Annotated[
    list[Annotated[list[_Column], Len(RESOLUTION[1], RESOLUTION[1])]], Len(RESOLUTION[0], RESOLUTION[0])
]


class Part(pydantic.BaseModel):
    """A part of a plan file: nothing may be missing, nothing unknown, every number is finite."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


class Agreement(Part):
    """How far an estimate agrees with what was seen, both as voxels."""

    silhouette_iou: Share
    """Intersection over union of the columns that hold cloth."""
    height_iou: Share
    """Of the occluded voxels: of all that lies below the surface."""
    explains: bool
    """Whether both are as high as is usual for estimates that can be relied on."""
    strangeness: NotNegative | None = None
    """How unlike the data that the net was trained on the voxels are, about 1 for these; null if that is not known."""
    known: bool = True
    """Whether the net knows such voxels, and cloths of these sides and this thickness."""


class UnsurePart(Part):
    """Where an estimate is poor: the vertices whose place has a standard deviation above a threshold."""

    threshold_m: NotNegative
    """0.05 times the cloth's side. The square of a vertex's standard deviation is the sum of those along x, y and z."""
    share: Share
    """The share of the cloth's vertices that are above it."""
    part: PartName | None
    """The part of the flat cloth that they are most like: a corner, an edge, the rim (all edges), a quarter, the
    middle, a half or the whole; null: there are none."""
    centre_m: Point | None
    """The middle of those in this part, as they are estimated to lie, in `frame`; null: there are none."""
    hidden: Share
    """The share of them that lies beneath another layer of the estimated mesh, where no camera above sees it."""
    unseen: Share
    """The share of them that lies where nothing was observed, and not beneath another layer."""

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "UnsurePart":
        check_unsure(self)
        return self


class NamedGoal(Part):
    """Which form of a named goal was planned for."""

    turn_deg: Literal[0, 90, 180, 270]
    """By how much its folds were turned on the cloth, counter-clockwise."""
    mirror: bool
    """Whether they were mirrored, before that."""
    angle_rad: Annotated[float, Ge(-math.pi), Le(math.pi)]
    """By how much the cloth lay turned on the table, and the goal with it."""


class Source(Part):
    """A file that was planned from or for, or a named goal."""

    file: str
    """Its name, or that of the goal."""
    kind: Kind
    """mesh: [32, 32, 3]; voxels: [32, 32, 16]; points: a cloud, or a surface seen from above."""
    taken: Usage | None = None
    """Whether the plan starts from (or leads to) what the file holds, or an estimate of it; null: an older version."""
    agreement: Agreement | None = None
    """Of the estimate with what the file shows; null: nothing was estimated, or the file is of an older version."""
    unsure: UnsurePart | None = None
    """Of a state whose mesh was estimated, where that is poor; null: not estimated, a goal, or an older version."""
    named: NamedGoal | None = None
    """The form of a named goal; null: a file."""


class Table(Part):
    """The table's frame: p_table = axes (p - origin_m)."""

    axes: tuple[Direction, Direction, Direction]
    """Its x, y and z (up), in `frame`: unit vectors at right angles."""
    origin_m: Point
    """In `frame`."""

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "Table":
        check_axes(self.axes)
        return self


class MeshState(Part):
    """A cloth as a mesh [u][v][x, y, z]; u and v run along its edges."""

    kind: Literal["mesh"]
    vertices_m: Grid
    """In `frame`."""
    sigma_m: Deviations | None
    """Standard deviations along x, y and z of the table's frame; null: not known."""


class VoxelState(Part):
    """A cloth as voxels [x][y][z] of the table's frame, normalised and centred: from (-1, -1, 0) to (1, 1, 0.125)."""

    kind: Literal["voxels"]
    occupancy: Occupancy
    """Probability that a voxel, or one above it, holds cloth."""


State = Annotated[MeshState | VoxelState, pydantic.Field(discriminator="kind")]


class Placed(Part):
    """A state and where it lies."""

    state: State
    centre_m: Point
    """The middle of what the cloth covers, on the table, in `frame`."""


class Waypoint(Part):
    """Where a hand is when."""

    time_s: Annotated[float, Ge(0), Le(3600)]
    """From the grasp; later than the waypoint before."""
    position_m: Point
    """In `frame`."""


class Hand(Part):
    """What one hand does: it closes at the grasp point, follows the waypoints, and opens at the release point."""

    grasp_m: Point
    """The first waypoint."""
    release_m: Point
    """The last one."""
    waypoints: Annotated[list[Waypoint], Len(2)]
    hand: Annotated[int, Ge(0), Le(1)] | None = None
    """Which of the robot's hands it is, where each has a reach of its own: 0 or 1; null: any."""

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "Hand":
        check_hand(self)
        return self


class Prediction(Part):
    """What one net expects after a step."""

    net: Annotated[int, Ge(0)]
    """The member of the ensemble."""
    state: State


class Step(Part):
    """One manipulation."""

    manipulation: tuple[Geodesic, Geodesic, Geodesic, Geodesic, Displacement, Displacement]
    """u1 v1 u2 v2: grasp points on the cloth, geodesic, -1..1 (x and y from its centre where the system plans in
    voxels); dx dy: displacement in the table's frame, normalised. One hand: the grasp point twice."""
    null: bool
    """Whether the displacement is too short for anything to be done; then there are no hands."""
    hands: Annotated[list[Hand], Len(0, 2)]
    predictions: Annotated[list[Prediction], Len(1, MOST_NETS)]
    centre_m: Point
    """Where the cloth's centre is expected afterwards, on the table, in `frame`."""
    disagreement_m: NotNegative | None
    """Distance between the vertices that two nets predict, the mean over vertices and pairs of nets; null: there is one
    net, or it predicts voxels."""

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "Step":
        check_step(self)
        return self


class Expectation(Part):
    """What the plan is expected to come to, by the mean of the nets' predictions."""

    error_cloth_lengths: NotNegative | None
    """Mean distance of the outcome's vertices to the goal's in the labels that the search found, moved to fit, as a
    share of the cloth's side; null where the system plans in voxels."""
    error_m: NotNegative | None
    error_no_action_cloth_lengths: NotNegative | None
    """The same of the state as it is."""
    error_no_action_m: NotNegative | None
    voxel_error: NotNegative | None
    """Mean difference of occupancy, where the system plans in voxels."""
    voxel_error_no_action: NotNegative | None
    silhouette_iou: Share
    """Intersection over union of what outcome and goal cover, both centred."""
    silhouette_iou_no_action: Share
    error_without_limits_m: NotNegative | None = None
    """`error_m` of the plan that was found first, and did not keep to the limits of the hands; null: it was kept."""
    outcome_error_m: NotNegative | None = None
    """Distance from the goal that plans with such an expectation came to, in the mean of executed validation plans:
    errors of nets and estimate are part of it. null: not known, or the file is of an older version."""
    outcome_error_low_m: NotNegative | None = None
    """80 % of these plans ended between this distance and the next."""
    outcome_error_high_m: NotNegative | None = None
    trust: Share | None = None
    """The share of these plans that ended at most 0.05 cloth lengths from their goals."""
    prediction_error_m: NotNegative | None = None
    """Expected error of the nets' prediction of the outcome, which `error_m` knows nothing of; null: the search was not
    told of it (plan.uncertainty.measure is not `expected`), nothing is done, or the file is of an older version."""
    epistemic_uncertainty: NotNegative | None
    """u of eq. (15): how much the nets disagree, against what is usual; null for one net, and where the search weighed
    another measure, or none (older versions have it all the same)."""
    loss: float
    """The planning loss: eq. (13), or another objective that the scale's settings have."""
    improves: bool
    """Whether the plan does anything, and its outcome is not expected to be farther from the goal than the state is; of
    a turned plan, whether that was so before."""


class Memory(Part):
    """What a later plan of the same session takes up (`clothkit plan --after`)."""

    common: Annotated[int, Ge(0), Le(7)]
    """The Cartesian equivalent in which the plan was found."""
    relative: Annotated[int, Ge(0), Le(7)]
    """The relabelling that brings the goal under the state's labels."""
    best: Annotated[int, Ge(0), Le(MOST_NETS - 1)]
    """Which of the predictions is that of the net with the best validation score."""
    traces_before: list[list[list[_Unit]]] | None
    """[net][label][unit]: memory traces before the plan; null: none, the session begins."""


class BoxRegion(Part):
    """The points between two corners, in the table's frame."""

    low_m: Point
    high_m: Point


class BallRegion(Part):
    """The points within a radius of a centre, in the table's frame."""

    centre_m: Point
    radius_m: Annotated[float, Gt(0)]


class HandLimits(Part):
    """What the hands were to keep to, in the table's frame: z up, the table at 0."""

    hands: Annotated[list[BoxRegion | BallRegion], Len(0, 2)]
    """Where they can be: one region for both, or one for each; none: anywhere."""
    keep_out: list[BoxRegion | BallRegion]
    """Where none may be."""
    apart_m: NotNegative
    """Least distance between the two hands of a step."""

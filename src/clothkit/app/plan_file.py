"""Plan files (JSON): a robot's motions and the expected outcome. `docs/plan.schema.json` is generated from this module.

Positions are in metres in `frame`; the inputs of nets and planning are there too, in normalised units. A plan whose
parts are impossible or contradict each other can be neither made nor read: `plan_checks` has the conditions.
"""

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from annotated_types import Ge, Gt, Le, Len

from clothkit.app.inputs import Kind, Usage
from clothkit.app.options import WITHIN
from clothkit.app.output import unfinished
from clothkit.app.plan_checks import check_axes, check_hand, check_plan, check_step
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import RESOLUTION
from clothkit.observation.pose import Pose
from clothkit.planning.systems import system
from clothkit.runtime.errors import InputError, system_error
from clothkit.runtime.json_file import parse_json

UNLIKELY = "this plan is not expected to improve the state"
WORSE = "plans with such an expectation ended farther from their goals than this cloth lies now"

_SHORT = 100

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
    epistemic_uncertainty: NotNegative | None
    """u of eq. (15): how much the nets disagree, against what is usual; null for one net."""
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


class Plan(Part):
    """A plan: from one observation, what to do in one to three steps."""

    format: Literal["clothkit plan"]
    version: Literal[2]
    """Files of version 1, whose nets are called a and b, are read, too."""
    system: str
    """How it was planned: main, b1, .."""
    seed: Annotated[int, Ge(0)]
    frame: Literal["camera", "table"]
    """Of every position here. camera: the frame of the points in the state's file. table: z is up, the table is at 0;
    meshes and voxels are in it."""
    state: Source
    goal: Source
    turned: tuple[tuple[float, float], tuple[float, float]] | None
    """The matrix in the table's plane that the goal was turned or mirrored by for the hands to reach all waypoints."""
    side_m: Annotated[float, Ge(0.01), Le(10)]
    """Of the flat cloth; the longer one if it is no square."""
    sides_m: tuple[Annotated[float, Ge(0.01), Le(10)], Annotated[float, Ge(0.01), Le(10)]] | None = None
    """Both sides, the longer one first; null: a square, or the file is of an older version."""
    thickness_m: Annotated[float, Gt(0), Le(1)] | None = None
    """Distance of the middles of two layers that touch; null: the file is of an older version."""
    metres_per_normalised: Annotated[float, Gt(0)]
    """side_m / 1.4."""
    table: Table
    limits: HandLimits | None = None
    """null: none, or the file is of an older version. They are of this plan alone: --after does not take them over."""
    start: Placed
    """What the state was taken for."""
    steps: Annotated[list[Step], Len(1, 3)]
    expected: Expectation
    warning: str | None
    """UNLIKELY, WORSE, or null. WORSE can be said of a plan that `expected.improves`: that is what its nets expect."""
    notices: list[str] = []
    """What was not seen of state or goal, and whether their estimates fail to explain what was."""
    memory: Memory

    @pydantic.model_validator(mode="after")
    def _agrees(self) -> "Plan":
        check_plan(self, system(self.system))
        return self

    def save(self, path: str | Path) -> None:
        """Write the plan as a file that all commands read. Raises InputError when it can't be written."""
        write_plan(Path(path), self)

    def pose(self, centre_m: Point) -> Pose:
        """The pose of a cloth whose centre [m, in `frame`] is given."""
        axes, origin = np.array(self.table.axes, float), np.array(self.table.origin_m, float)
        still = Pose(axes, origin, np.zeros(2), self.metres_per_normalised)
        centre = still.camera_to_table(np.array(centre_m, float))[:2]
        return Pose(axes, origin, centre, self.metres_per_normalised)


_MEMBERS = {"a": 0, "b": 1}
"""Members of the ensemble by their names in version 1."""


def _of_version_2(text: bytes) -> bytes:
    """The JSON of a plan file of version 1 as version 2 has it; anything else unchanged, JSON or not."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return text
    if not isinstance(content, dict) or type(content.get("version")) is not int or content["version"] != 1:
        return text
    memory, steps = content.get("memory"), content.get("steps")
    if isinstance(memory, dict) and "best" not in memory:
        content["memory"] = {"best" if name == "better" else name: value for name, value in memory.items()}
    for step in steps if isinstance(steps, list) else ():
        predictions = step.get("predictions") if isinstance(step, dict) else None
        for prediction in predictions if isinstance(predictions, list) else ():
            if isinstance(prediction, dict) and isinstance(prediction.get("net"), str):
                prediction["net"] = _MEMBERS.get(prediction["net"], prediction["net"])
    return json.dumps({**content, "version": 2}).encode()


def schema() -> dict[str, Any]:
    """The JSON schema of plan files."""
    found = Plan.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found, "title": "A plan of clothkit"}


def write_plan(path: Path, plan: Plan) -> None:
    """Write a plan file as a whole or not at all. Raises InputError when it can't be written."""
    with unfinished(path) as part:
        part.write_text(lines(plan.model_dump(mode="json")) + "\n")


def plan_of(content: dict[str, Any]) -> Plan:
    """Build a plan from its fields. Raises InputError that names the first invalid field."""
    try:
        return Plan.model_validate(content)
    except pydantic.ValidationError as error:
        raise InputError(f"the plan found: {_first(error)}") from error


def read_plan(path: Path) -> Plan:
    """Read a plan file of version 1 or 2. Raises InputError that names the file and the first invalid field."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise system_error(error, path, expected="a plan, as clothkit plan writes it") from error
    try:
        plan = Plan.model_validate_json(_of_version_2(text), strict=True)
    except pydantic.ValidationError as error:
        raise InputError(f"{path}: {_first(error)}") from error
    # pydantic takes the last of keys that stand twice.
    parse_json(path, text, expected="a plan")
    return plan


def _first(error: pydantic.ValidationError) -> str:
    """Return the message of the first error, with the field's name before it."""
    first = error.errors(include_url=False, include_context=False)[0]
    if first["type"] == "json_invalid":
        return "is not valid JSON, expected a plan"
    place, message, found = [str(part) for part in first["loc"]], first["msg"], first["input"]
    if first["type"] == "value_error":
        # The message comes from `plan_checks`, and so begins with a field's name.
        return ".".join([*place, message.removeprefix("Value error, ")])
    message = f"{'.'.join(place) or 'plan'}: {message[0].lower()}{message[1:]}"
    return message if isinstance(found, dict | list) else f"{message}, found {found!r:.40}"


def lines(value: Any, indent: str = "") -> str:
    """Return JSON with one line per field; short values and lists of numbers stay on one line."""
    text, inner = json.dumps(value), indent + " "
    if len(text) <= _SHORT or (isinstance(value, list) and _depth(value) <= 2):
        return text
    if isinstance(value, dict):
        fields = [f"{inner}{json.dumps(name)}: {lines(field, inner)}" for name, field in value.items()]
        return "{\n" + ",\n".join(fields) + f"\n{indent}}}"
    if isinstance(value, list):
        return "[\n" + ",\n".join(inner + lines(part, inner) for part in value) + f"\n{indent}]"
    return text


def _depth(value: Any) -> int:
    """Return the nesting depth of lists of numbers; a large number if they hold dictionaries."""
    if isinstance(value, list):
        return 1 + (_depth(value[0]) if value else 0)
    return 99 if isinstance(value, dict) else 0


def rounded(values: np.ndarray, digits: int) -> Any:
    """Return an array as nested lists of numbers, rounded to `digits` decimals."""
    return np.round(np.asarray(values, float), digits).tolist()

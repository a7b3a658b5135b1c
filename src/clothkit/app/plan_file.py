"""Plan files (JSON): a robot's motions and the expected outcome. `docs/plan.schema.json` is generated from this module.

`plan_parts` declares what they consist of.

Positions are in metres in `frame`; the inputs of nets and planning are there too, in normalised units. A plan whose
parts are impossible or contradict each other can be neither made nor read: `plan_checks` has the conditions.
"""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from annotated_types import Ge, Gt, Le, Len

from clothkit.app.output import unfinished
from clothkit.app.plan_checks import check_plan
from clothkit.app.plan_parts import (
    Expectation,
    HandLimits,
    Memory,
    Part,
    Placed,
    Point,
    Source,
    Step,
    Table,
)
from clothkit.observation.pose import Pose
from clothkit.planning.systems import system
from clothkit.runtime.errors import InputError, system_error
from clothkit.runtime.json_file import parse_json

UNLIKELY = "this plan is not expected to improve the state"
WORSE = "plans with such an expectation ended farther from their goals than this cloth lies now"

_SHORT = 100


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
    table_in_camera: Table | None = None
    """Where `frame` is table and the state's file holds points, the table in the frame of these: a position p of that
    frame is axes (p - origin_m) here; null: `table` says it, or the file is of an older version."""
    limits: HandLimits | None = None
    """null: none, or the file is of an older version. They are of this plan alone: --after does not take them over."""
    start: Placed
    """What the state was taken for."""
    steps: Annotated[list[Step], Len(1, 3)]
    expected: Expectation
    warning: str | None
    """UNLIKELY, WORSE, or null. WORSE can be said of a plan that `expected.improves`: that is what its nets expect."""
    notices: list[str] = []  # noqa: RUF012, as pydantic copies it
    """What was not seen of state or goal, whether their estimates fail to explain what was, where the estimate is poor,
    why nothing is known of the plan's trust, and what to do about all this: a sentence each."""
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

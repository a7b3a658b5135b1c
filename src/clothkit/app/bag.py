"""`clothkit bag`: a plan as timed poses of both grippers, in a bag that ROS 2 plays."""

import os
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from clothkit.app.extras import optional
from clothkit.app.plan_file import Plan, read_plan
from clothkit.app.plan_parts import Hand
from clothkit.runtime.errors import InputError, system_error
from clothkit.runtime.publish import publish

BEGINS_S = 1.0
"""Time of the first message: ROS takes a stamp of 0 for one that is not set."""

_NANOSECONDS = 10**9


@click.command(short_help="A plan as timed poses of the grippers, for ROS 2.")
@click.option("--plan", "source", required=True, type=click.Path(path_type=Path), metavar="PLAN", help="A plan file.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("plan_bag"),
    show_default=True,
    metavar="FOLDER",
    help="The bag: a folder that is not there yet.",
)
@click.option(
    "--steps",
    type=click.IntRange(1, 3),
    default=1,
    show_default=True,
    help="So many steps of the plan. Later ones are for a cloth that nobody has seen yet.",
)
@click.option("--frame-id", metavar="NAME", help="Of the poses. [default: the plan's frame, camera or table]")
@click.option(
    "--grip",
    type=click.FloatRange(0, 60),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="Time that grippers have to open and to close.",
)
@click.option(
    "--pause",
    type=click.FloatRange(0, 600),
    default=5.0,
    show_default=True,
    metavar="SECONDS",
    help="Time between two steps: for arms to get to the next grasp, and for the cloth to come to rest.",
)
def command(*, source: Path, out: Path, steps: int, frame_id: str | None, grip: float, pause: float) -> None:
    """Write a plan as a bag of ROS 2 (rosbag2, SQLite), which `ros2 bag play` plays.

    Each hand k (1, 2) has two topics: /clothkit/hand_k/pose (geometry_msgs/PoseStamped), a message for each of the
    plan's waypoints at its time, and /clothkit/hand_k/closed (std_msgs/Bool), whether its gripper is closed. Grippers
    point down at the table (the pose's z axis), their x axis in the direction of their hand's motion.

    \b
    clothkit bag --plan plan.json --out plan_bag
    ros2 bag play plan_bag
    """
    plan = read_plan(source)
    if steps > len(plan.steps):
        raise InputError(f"--steps: expected at most {len(plan.steps)}, the steps of {source}, found {steps}")
    found = schedule(plan, steps=steps, grip=grip, pause=pause)
    if not found:
        raise InputError(
            f"{source}: nothing is done in step {'1' if steps == 1 else f'1 to {steps}'}, so there is no bag of it"
        )
    write_bag(out, found, frame_id=frame_id or plan.frame)
    last = max(poses[-1].time_s for poses, _ in found.values())
    click.echo(f"{out}: {len(found)} hand{'s' if len(found) > 1 else ''}, {last - BEGINS_S:.1f} s")


class TimedPose(NamedTuple):
    """Where a gripper is when, in the plan's frame."""

    time_s: float
    position_m: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    """Quaternion x y z w."""


class TimedGrip(NamedTuple):
    """Whether a gripper is closed from some time on."""

    time_s: float
    closed: bool


class Schedule(NamedTuple):
    """What one hand does when."""

    poses: list[TimedPose]
    grips: list[TimedGrip]


def schedule(plan: Plan, *, steps: int, grip: float, pause: float) -> dict[int, Schedule]:
    """What each hand that does anything in the first steps of a plan does when, by its number (1, 2).

    In each step a hand is at its grasp point with an open gripper for `grip` seconds, closes it within as many, follows
    the waypoints, and opens it within as many; the next step begins `pause` seconds later.
    """
    found: dict[int, Schedule] = {}
    begins, down = BEGINS_S, -np.array(plan.table.axes[2], float)
    for step in plan.steps[:steps]:
        for place, hand in enumerate(step.hands):
            number = 1 + (place if hand.hand is None else hand.hand)
            poses, grips = found.setdefault(number, Schedule([], []))
            orientation = _orientation(hand, down)
            grips += [TimedGrip(begins, False), TimedGrip(begins + grip, True)]
            poses.append(TimedPose(begins, hand.grasp_m, orientation))
            moving = begins + 2 * grip
            poses += [TimedPose(moving + point.time_s, point.position_m, orientation) for point in hand.waypoints]
            grips.append(TimedGrip(poses[-1].time_s, False))
        if step.hands:
            begins += step.hands[0].waypoints[-1].time_s + 3 * grip + pause
    return found


def _orientation(hand: Hand, down: Float[np.ndarray, "3"]) -> tuple[float, float, float, float]:
    """The quaternion x y z w of a gripper whose z axis points down and whose x axis is the direction of the motion."""
    along = np.subtract(hand.release_m, hand.grasp_m)
    along = along - (along @ down) * down
    length = np.linalg.norm(along)
    # A hand that only lifts has no direction: any one does.
    along = along / length if length > 1e-9 else np.linalg.svd(down[None])[2][1]
    matrix = np.column_stack([along, np.cross(down, along), down])
    x, y, z, w = Rotation.from_matrix(matrix).as_quat().tolist()
    return x, y, z, w


def write_bag(path: Path, schedules: dict[int, Schedule], *, frame_id: str) -> None:
    """Write a bag as a whole or not at all. Raises InputError if it is there already or can't be written."""
    rosbag2, typesys = optional("rosbags.rosbag2", "ros2"), optional("rosbags.typesys", "ros2")
    if os.path.lexists(path):
        raise InputError(f"{path}: is there already, expected the name of a new folder")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: {path.parent} is no folder, it must be there")
    try:
        with tempfile.TemporaryDirectory(prefix=".part", dir=path.absolute().parent) as part:
            # The bag's file has the folder's name, so the folder is written under its own.
            unfinished = Path(part) / path.name
            # Version 8 is the newest that all distributions since Humble read.
            with rosbag2.Writer(unfinished, version=8) as writer:
                _write(writer, typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), schedules, frame_id)
            publish(unfinished, path)
    except OSError as error:
        raise system_error(error, path, action="written") from error


def _write(writer: Any, store: Any, schedules: dict[int, Schedule], frame_id: str) -> None:
    types = store.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    point, quaternion = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Quaternion"]
    pose, posed, told = (
        types["geometry_msgs/msg/Pose"],
        types["geometry_msgs/msg/PoseStamped"],
        types["std_msgs/msg/Bool"],
    )
    messages: list[tuple[int, Any, bytes]] = []
    for number, (poses, grips) in sorted(schedules.items()):
        of_poses, of_grips = (
            writer.add_connection(f"/clothkit/hand_{number}/{name}", kind.__msgtype__, typestore=store)
            for name, kind in (("pose", posed), ("closed", told))
        )
        for timed in poses:
            time = round(timed.time_s * _NANOSECONDS)
            message = posed(
                header(stamp(*divmod(time, _NANOSECONDS)), frame_id),
                pose(point(*timed.position_m), quaternion(*timed.orientation)),
            )
            messages.append((time, of_poses, store.serialize_cdr(message, posed.__msgtype__)))
        for grip in grips:
            time = round(grip.time_s * _NANOSECONDS)
            messages.append((time, of_grips, store.serialize_cdr(told(grip.closed), told.__msgtype__)))
    for time, connection, content in sorted(messages, key=lambda message: message[0]):
        writer.write(connection, time, content)

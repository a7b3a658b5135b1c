"""A plan that nobody searched for, as a plan file has it: every part agrees with the others."""

import json
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from clothkit.app.output import write_mesh
from clothkit.cloth.silhouette import centred
from clothkit.cloth.topology import SQUARE, Topology
from clothkit.cloth.voxels import RESOLUTION
from clothkit.observation.pose import Pose
from clothkit.observation.waypoints import hand_paths, paths_from
from clothkit.planning.planner import Planner
from clothkit.planning.systems import system
from clothkit.planning.types import Found, Problem
from tests.planning import toy
from tests.tiny import AT

BOTH = np.array([1.0, -1.0, 1.0, 1.0, -1.3, 0.0], np.float32)
ONE = np.array([-1.0, -1.0, -1.0, -1.0, 0.6, 0.5], np.float32)


def finding(plan: np.ndarray, *, common: int = 0, relative: int = 0) -> Any:
    """In place of searches: as if they found the first steps of a plan, whatever they are asked."""

    def search(planner: Planner, problems: Problem, keys: jax.Array, *, length: int) -> Found:
        tasks = len(problems.state)
        size = (tasks, *planner.settings.search.optimiser.shape(length))
        return Found(
            plan=jnp.broadcast_to(plan[:length], (tasks, length, 6)),
            loss=jnp.zeros(tasks),
            terms={"accuracy": jnp.zeros((tasks, len(planner.nets)))},
            common=jnp.full(tasks, common, jnp.int32),
            relative=jnp.full(tasks, relative, jnp.int32),
            losses=jnp.zeros(size),
        )

    return mock.patch.object(Planner, "search", search)


def content(
    name: str = "b1",
    *,
    side: float = 0.4,
    vectors: tuple[np.ndarray, ...] = (BOTH, ONE),
    camera: tuple[np.ndarray, np.ndarray] | None = None,
    members: tuple[int, ...] = (0, 1),
    topology: Topology = SQUARE,
) -> dict[str, Any]:
    """Manipulations of a flat cloth; nets expect what the toy world makes of them, the first one of them if one plans.

    In the table's frame, or in that of a camera, in which the table has these axes and this origin.
    """
    chosen = system(name)
    members = members[:1] if chosen.single else members
    several = len(members) > 1
    axes, origin = camera or (np.eye(3), np.zeros(3))
    poses, mesh, steps = [Pose(axes, origin, np.array(AT), side / 1.4)], topology.flat(), []
    start = {"state": _state(mesh, chosen.voxels, poses[0]), "centre_m": _centre(poses[0])}
    for vector in vectors:
        paths = hand_paths(vector, mesh, poses[-1])
        if chosen.voxels:
            paths = paths_from(np.insert(vector[:4].reshape(2, 2), 2, 0, axis=1), vector, poses[-1])
        mesh, moved = centred(np.asarray(toy.dragged(jnp.asarray(mesh), jnp.asarray(vector))))
        poses.append(poses[-1].moved(moved))
        times = paths.times.round(4).tolist()
        hands = [
            {
                "grasp_m": points[0],
                "release_m": points[-1],
                "waypoints": [{"time_s": t, "position_m": at} for t, at in zip(times, points, strict=True)],
                "hand": None,
            }
            for points in poses[0].table_to_camera(paths.points).round(6).tolist()
        ]
        state = _state(mesh, chosen.voxels, poses[-1])
        steps.append(
            {
                "manipulation": vector.astype(float).tolist(),
                "null": False,
                "hands": hands,
                "predictions": [{"net": member, "state": state} for member in members],
                "centre_m": _centre(poses[-1]),
                "disagreement_m": 0.0 if several and not chosen.voxels else None,
            }
        )
    of_mesh, of_voxels = (None, 0.1) if chosen.voxels else (0.1, None)
    return {
        "format": "clothkit plan",
        "version": 2,
        "system": name,
        "seed": 0,
        "frame": "camera" if camera else "table",
        "state": {"file": "start.obj", "kind": "mesh", "taken": "as it is", "agreement": None},
        "goal": {"file": "goal.obj", "kind": "mesh", "taken": "as it is", "agreement": None},
        "notices": [],
        "turned": None,
        "side_m": side,
        "metres_per_normalised": side / 1.4,
        "table": {"axes": axes.tolist(), "origin_m": origin.tolist()},
        "start": start,
        "steps": steps,
        "expected": {
            "error_cloth_lengths": of_mesh,
            "error_m": of_mesh and of_mesh * side,
            "error_no_action_cloth_lengths": of_mesh and 2 * of_mesh,
            "error_no_action_m": of_mesh and 2 * of_mesh * side,
            "voxel_error": of_voxels,
            "voxel_error_no_action": of_voxels and 2 * of_voxels,
            "silhouette_iou": 0.9,
            "silhouette_iou_no_action": 0.5,
            "epistemic_uncertainty": 0.1 if several else None,
            "loss": 0.3,
            "improves": True,
        },
        "warning": None,
        "memory": {"common": 0, "relative": 0, "best": 0, "traces_before": None},
    }


def version_1(plan: dict[str, Any]) -> dict[str, Any]:
    """The same plan as files of version 1 had it: nets called a and b, of which one is the better."""
    plan = json.loads(json.dumps(plan))
    for step in plan["steps"]:
        for prediction in step["predictions"]:
            prediction["net"] = "ab"[prediction["net"]]
    plan["memory"]["better"] = plan["memory"].pop("best")
    return {**plan, "version": 1}


def _state(mesh: np.ndarray, voxels: bool, pose: Pose) -> dict[str, Any]:
    if voxels:
        return {"kind": "voxels", "occupancy": np.ones(RESOLUTION).tolist()}
    metres = pose.normalised_to_camera(mesh.astype(float))
    return {"kind": "mesh", "vertices_m": metres.round(6).tolist(), "sigma_m": None}


def _centre(pose: Pose) -> list[float]:
    return pose.table_to_camera(np.append(pose.centre, 0.0)).round(7).tolist()


def write(path: Path, plan: dict[str, Any]) -> None:
    """A plan file, and the cloth that it is about as start.obj."""
    path.write_text(json.dumps(plan))
    write_mesh(path.with_name("start.obj"), SQUARE.flat().astype(float) * plan["side_m"] / 1.4 + [*AT, 0])


def changed(plan: dict[str, Any], field: str, value: object) -> dict[str, Any]:
    """The plan with the value of a field, `steps.0.hands` for example; ... removes it."""
    plan = json.loads(json.dumps(plan))
    *path, last = (int(part) if part.isdigit() else part for part in field.split("."))
    place: Any = plan
    for part in path:
        place = place[part]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return plan

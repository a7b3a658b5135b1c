"""Can the household nets fold a towel before a depth camera?  python studies/towel.py [REPEATS] [options]

A towel (--sides, --thickness; default 0.5 x 0.3 m, 5 mm, fabric `towel` at that size) lies flat on the table, REPEATS
times (default: 10) at another angle, before the depth camera of params.yaml (evaluate_camera.picture, condition
`noise x1`). Hands that take all layers fold it in half and in quarters: these are the goals. System main plans and
executes

half             the half fold, from the flat towel
half to quarter  the second fold, from the half-folded towel
quarter          both, from the flat towel, with a look in between

A row per repeat and task goes to reports/<scale>/studies/towel.csv: error of the outcome [cloth length] and that of no
action, and the intersection over union of the silhouettes of outcome and goal, and of start and goal. The means with
95 % bootstrap intervals over repeats are printed. The nets are those in `--data` (default: data), the settings those of
the scale at which they were made.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from clothkit.app.prebuilt import user_folder
from clothkit.cloth.silhouette import centred, iou, silhouette
from clothkit.cloth.topology import CLOTH_LENGTH, Topology, rectangle
from clothkit.dataset.store import SPLITS, Dataset
from clothkit.dataset.tasks import Task
from clothkit.episodes.depth_camera import depth_camera
from clothkit.episodes.record import Sessions, tasks_of_dataset
from clothkit.episodes.sessions import run_sessions
from clothkit.evaluation.camera import picture_settings
from clothkit.evaluation.comparisons import interval
from clothkit.evaluation.errors import errors
from clothkit.models import store
from clothkit.params import Params, load_params
from clothkit.planning.objective import Weights
from clothkit.planning.planner import Planner, assemble
from clothkit.planning.systems import SYSTEMS
from clothkit.prebuilt.files import unpacked
from clothkit.prebuilt.manifest import MANIFEST
from clothkit.runtime.errors import InputError
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.executor import end_workers, execute, make_simulator
from clothkit.simulation.material import FABRICS, Material
from clothkit.simulation.settings import DRAWN, SimulationConfig
from clothkit.simulation.similarity import resized

TASKS = {(0, 1): "half", (1, 1): "half to quarter", (0, 2): "quarter"}
"""Names of the tasks by start and length."""
REACH = 0.89
"""Displacement of the hands in sides of the towel: the edge that they let go slides on."""
CONDITION = "noise x1"

FOLDS = (((-1.0, -1.0, -1.0, 1.0), 0), ((-1.0, -1.0, 0.0, -1.0), 1))
"""Grasp points u1 v1 u2 v2 of the half fold and of the next one, and the axis along which the hands move."""


def towels(
    repeats: int, sides: tuple[float, float], thickness: float, simulation: SimulationConfig, *, seed: int = 0
) -> Dataset:
    """Return a sequence per repeat, normalised: the flat towel at a random angle, folded in half and in quarters."""
    longer, shorter = max(sides), min(sides)
    topology = rectangle(longer / shorter, shape=simulation.topology.shape)
    scale = CLOTH_LENGTH / longer
    size = longer / simulation.cloth_side
    material = dataclasses.replace(resized(FABRICS["towel"], size), thickness=thickness / size)
    cloths = cloths_of(repeats, (CLOTH_LENGTH, shorter * scale, thickness * scale), material)
    angles = np.random.default_rng(seed).uniform(0, 2 * np.pi, repeats)
    states, manipulations = [flat_towels(topology, thickness * scale, angles)], []
    for (u1, v1, u2, v2), axis in FOLDS:
        distance = REACH * topology.sides[axis]
        move = np.eye(2)[axis] * distance
        moves = np.stack([turn(move, angle) for angle in angles])
        grasped = np.stack([grasp_points(mesh, topology, (u1, v1, u2, v2)) for mesh in states[-1]])
        single = np.zeros(repeats, bool)
        states.append(execute(states[-1], grasped, moves, single, cloths, settings=simulation))
        manipulations.append(np.concatenate([np.tile([u1, v1, u2, v2], (repeats, 1)), moves], axis=1))
    return as_dataset(np.stack(states, axis=1), np.stack(manipulations, axis=1), cloths)


def cloths_of(count: int, measures: tuple[float, float, float], material: Material) -> Cloths:
    """Return so many cloths with these sides and thickness [normalised] and this material, flat at first."""
    exact = np.array([getattr(material, name) for name in DRAWN])
    nearest = exact.astype(np.float32)
    # Rounded down, so that none leaves its range.
    properties = np.where(nearest > exact, np.nextafter(nearest, np.float32(0)), nearest)
    return Cloths(
        np.tile(np.array(measures, np.float32), (count, 1)),
        np.zeros(count, np.int8),
        np.tile(properties, (count, 1)),
    )


def turn(xy: Float[np.ndarray, "*batch 2"], angle: float) -> Float[np.ndarray, "*batch 2"]:
    """Return vectors turned about z by an angle [rad]."""
    return xy @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def flat_towels(topology: Topology, thickness: float, angles: np.ndarray) -> Float[np.ndarray, "angles u v 3"]:
    """Return flat towels at these angles; their vertices lie in their middle."""
    flat = topology.flat().astype(float)
    found = np.stack([np.concatenate([turn(flat[..., :2], angle), flat[..., 2:]], axis=-1) for angle in angles])
    found[..., 2] = thickness / 2
    return found.astype(np.float32)


def grasp_points(
    mesh: Float[np.ndarray, "u v 3"], topology: Topology, uv: tuple[float, float, float, float]
) -> Float[np.ndarray, "2 2"]:
    """Return where on the table the vertices nearest to two points (u, v) lie."""
    geodesic = topology.geodesic().reshape(-1, 2)
    nearest = [np.linalg.norm(geodesic - point, axis=-1).argmin() for point in (uv[:2], uv[2:])]
    return mesh.reshape(-1, 3)[nearest, :2].astype(float)


def as_dataset(
    states: Float[np.ndarray, "repeat 3 u v 3"], manipulations: Float[np.ndarray, "repeat 2 6"], cloths: Cloths
) -> Dataset:
    """Return test sequences of two manipulations in which these states follow one another."""
    repeats = len(states)
    vertices = np.full((repeats, 4, *states.shape[2:]), np.nan, np.float32)
    centre, manipulation = np.full((repeats, 4, 2), np.nan, np.float32), np.full((repeats, 3, 6), np.nan, np.float32)
    for repeat, state in np.ndindex(repeats, 3):
        vertices[repeat, state], centre[repeat, state] = centred(states[repeat, state])
    manipulation[:, :2] = manipulations
    hands = np.tile(np.array([2, 2, 0], np.int8), (repeats, 1))
    every = np.ones(repeats, np.int8)
    split = SPLITS.index("test") * every
    return Dataset(vertices, centre, manipulation, hands, 2 * every, split, every.astype(bool), *cloths)


def rows_of(sessions: Sessions) -> pd.DataFrame:
    """Return a row per session with its errors and the overlap of silhouettes."""
    outcome, start = sessions.state[np.arange(len(sessions)), sessions.length], sessions.state[:, 0]
    goals = [silhouette(goal) for goal in sessions.goal]
    overlap = {
        name: [iou(silhouette(mesh), goal) for mesh, goal in zip(meshes, goals, strict=True)]
        for name, meshes in {"iou": outcome, "iou_no_action": start}.items()
    }
    kept = {"cloth": sessions.cloth, "aligned": True}
    found = {
        "repeat": sessions.sequence,
        "task": [TASKS[key] for key in zip(sessions.start.tolist(), sessions.length.tolist(), strict=True)],
        "error": np.asarray(errors(outcome, sessions.goal, **kept)),
        "error_no_action": np.asarray(errors(start, sessions.goal, **kept)),
    }
    return pd.DataFrame({**found, **overlap})


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return means with their intervals by task."""
    found = []
    for name, own in table.groupby("task", sort=False):
        row: dict[str, object] = {"task": name, "repeats": len(own)}
        for measure in ("error", "error_no_action", "iou", "iou_no_action"):
            values = own[measure].to_numpy()
            low, high = interval(values, np.ones(len(values)))
            row |= {measure: values.mean(), f"{measure}_low": low, f"{measure}_high": high}
        found.append(row)
    return pd.DataFrame(found)


def unpacked_nets(folder: Path) -> Path:
    """Return a folder of nets, unpacked where they are prebuilt ones."""
    return unpacked(folder, keep=user_folder()) if (folder / MANIFEST).exists() else folder


def params_of(data: Path) -> Params:
    """Return the params at the scale at which the nets in `data` were made; if they do not say, at the selected one."""
    params = load_params(Path("params.yaml"))
    scale = store.description(data / "nets/vtm").get("scale", params.scale)
    if scale not in params.scales:
        raise InputError(f"{data}/nets/vtm: was made at scale {scale}, of which params.yaml has no block")
    return params.model_copy(update={"scale": scale})


def main() -> None:
    """Run the study and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("repeats", type=int, nargs="?", default=10)
    parser.add_argument("--sides", type=float, nargs=2, default=[0.5, 0.3], metavar="METRES")
    parser.add_argument("--thickness", type=float, default=0.005, metavar="METRES")
    parser.add_argument("--data", type=Path, default=Path("data"))
    asked = parser.parse_args()
    params = params_of(asked.data)
    stages = params.stages
    simulation = dataclasses.replace(stages.simulate.simulation, grasp="all")
    simulator = make_simulator(dataclasses.replace(stages.simulate, simulation=simulation))
    weights = Weights(params.alpha, params.beta, params.gamma)
    planner: Planner = assemble(
        SYSTEMS["main"], asked.data, weights, stages.plan, stages.simulate.candidates, params.ensemble.members
    )
    dataset = towels(asked.repeats, tuple(asked.sides), asked.thickness, simulation)
    conditions = {each.name: each for each in stages.evaluate_camera.conditions}
    if CONDITION not in conditions:
        parser.exit(1, f"towel: params.yaml: evaluate_camera.conditions has no {CONDITION!r}\n")
    sensor = depth_camera(picture_settings(stages.evaluate_camera, conditions[CONDITION]), planner.perception)
    chosen = [Task(repeat, start, length) for repeat in range(asked.repeats) for start, length in TASKS]
    sessions = run_sessions(tasks_of_dataset(dataset, chosen, "test"), planner, simulator, sensor=sensor)
    end_workers()
    table = rows_of(sessions)
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "towel.csv", index=False, float_format="%.5g", lineterminator="\n")
    print(summary(table).round(3).to_string(index=False))


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"towel: {error}") from error

"""Does a towel become what was asked for?  python studies/closed_loop.py [REPEATS] [options]

A towel (--sides, --thickness; default 0.5 x 0.3 m, 5 mm, fabric `towel`) lies flat, dragged and crumpled on the table
(--starts), REPEATS times each (default: 2). `clothkit.Agent` is told a named goal (--goal, default half): it sees noisy
points of a depth camera, chooses how many manipulations are worth it, has their plans executed in the simulator, looks
after each, and ends when it wants to do no more. The nets are those in --data (default: the prebuilt ones).

A row per look goes to reports/<scale>/studies/closed_loop.csv, and a picture per session to closed_loop/ beside it:
look by look the true cloth, the voxels that were seen, the estimate with the hands' paths, and the outcome that the
nets expect; in the end the goal. --record FOLDER keeps the sessions as recordings of Rerun, too. Columns:

goal, start, repeat   what the session is; step is the number of the look, from 0
estimated, agreement  distance from the goal as the agent sees it; whether its estimate explains what was seen
error, iou            true distance from the goal as the agent laid it; overlap of both silhouettes
steps, expected       manipulations of the plan; error that the nets expect of it
outcome, trust        mean error of validation plans with such an expectation; share of them that came true
notices               what the agent said of what it saw
end                   why there is no next look; empty if there is one

Errors are in cloth lengths. Columns of plans are empty where none was made.
"""

import argparse
import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

import clothkit
from clothkit.app.prebuilt import load_nets
from clothkit.app.viewer.session import ShownPlan
from clothkit.cloth.mesh import error
from clothkit.cloth.silhouette import centred, iou, silhouette
from clothkit.cloth.topology import CLOTH_LENGTH, triangles
from clothkit.goals.settings import START_NAMES, EvaluateGoalsConfig
from clothkit.goals.starts import cloth_of, cloths_of, start_of
from clothkit.manipulation.named_folds import GOALS
from clothkit.observation.camera import CameraConfig, back_project, render
from clothkit.observation.noise import NoiseConfig, noisy
from clothkit.params import load_params
from clothkit.prebuilt.manifest import MANIFEST
from clothkit.prebuilt.manifest import read as read_manifest
from clothkit.report import panels
from clothkit.report.draw import draw, draw_heights
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import execute
from clothkit.simulation.material import FABRICS
from clothkit.simulation.settings import SimulateConfig, SimulationConfig, VariationConfig
from clothkit.simulation.variation import Drawn

CAMERA = CameraConfig(height=0.9)
DONE, USED_UP = "nothing more is worth doing", "no manipulation is left"
COLUMNS = (
    *("goal", "start", "repeat", "step", "estimated", "agreement", "error", "iou"),
    *("steps", "expected", "outcome", "trust", "notices", "end"),
)
HEADINGS = ("true", "seen", "estimate", "expected")

Mesh = Float[np.ndarray, "u v 3"]
"""Normalised."""
Points = tuple[Float[np.ndarray, "points 3"], Bool[np.ndarray, " points"] | None]
"""Points [m], and which of them are the cloth's."""


class Look(NamedTuple):
    """A true state, what the agent saw of it, and what it planned."""

    mesh: Mesh
    """At its place on the table."""
    row: dict[str, Any]
    voxels: Bool[np.ndarray, "x y z"] | None = None
    """None: the agent refused what it saw."""
    estimate: Mesh | None = None
    plan: ShownPlan | None = None


def play(
    agent: clothkit.Agent, mesh: Mesh, see: Callable[[Mesh], Any], follow: Callable[[Mesh, clothkit.Plan], Mesh]
) -> list[Look]:
    """Observe, plan and execute until the agent wants to do no more, or can't; its session has begun.

    `see` returns what the agent observes, and a mask or None; `follow` what a plan's first step makes of a cloth.
    """
    looks = list[Look]()
    while not looks or not looks[-1].row["end"]:
        look, plan, end = Look(mesh, {"step": len(looks)}), None, USED_UP
        cloth, mask = see(mesh)
        try:
            look = looked(agent, agent.observe(cloth, mask=mask), look)
            if agent.left:
                plan = agent.plan()
                end = "" if plan.expected.improves else DONE
        except InputError as refused:
            end = str(refused)
        if plan is not None:
            look = look._replace(plan=agent.session.steps[-1].plan, row={**look.row, **expectation(plan)})
            if not end and not plan.steps[0].null:
                mesh = follow(mesh, plan)
        looks.append(look._replace(row={**look.row, "end": end}))
    return looks


def looked(agent: clothkit.Agent, seen: clothkit.ObservedCloth, look: Look) -> Look:
    """Return the look with what the agent takes the cloth for, and how far that and the cloth are from the goal."""
    state = agent.state
    assert state.perceived is not None, "an agent that has observed something"
    here = centred(look.mesh)[0]
    row = {
        "estimated": seen.error,
        "agreement": None if seen.agreement is None else seen.agreement.reliable,
        "error": float(error(here, state.target, aligned=True, cloth=state.goal.cloth)),
        "iou": iou(silhouette(here), silhouette(state.target)),
        "notices": " ".join(seen.notices),
    }
    voxels = state.perceived.source.observation.voxels
    return look._replace(row={**look.row, **row}, voxels=voxels, estimate=state.perceived.state)


def expectation(plan: clothkit.Plan) -> dict[str, Any]:
    """Return the columns of a plan."""
    told = plan.expected
    return {
        "steps": sum(not step.null for step in plan.steps),
        "expected": told.error_cloth_lengths,
        "outcome": None if told.outcome_error_m is None else told.outcome_error_m / plan.side_m,
        "trust": told.trust,
    }


def world_of(sides: tuple[float, float], thickness: float, simulation: SimulationConfig) -> SimulateConfig:
    """Return the world of a towel with these sides and this thickness [m], in the size that is simulated."""
    longer, shorter = max(sides), min(sides)
    towel = dataclasses.replace(FABRICS["towel"], thickness=thickness * simulation.cloth_side / longer)
    ratio = longer / shorter
    variation = VariationConfig(squares=float(longer == shorter), ratio=(ratio, ratio))
    return SimulateConfig(sequences=1, simulation=dataclasses.replace(simulation, material=towel), variation=variation)


def camera_above(side: float, thickness: float, *, seed: int) -> Callable[[Mesh], Points]:
    """Return what a depth camera sees of a cloth with that longer side [m], with other noise at each look."""
    scale, seeds = side / CLOTH_LENGTH, itertools.count(1000 * seed)

    def see(mesh: Mesh) -> Points:
        # The camera sees the upper side, half a layer above the vertices.
        surface = mesh.astype(float) * scale + [0, 0, thickness / 2]
        image = noisy(render(surface, triangles(mesh.shape[:2]), CAMERA), NoiseConfig(), seed=next(seeds))
        cloud = back_project(image)
        return cloud.points, cloud.cloth

    return see


def hands_in(drawn: Drawn) -> Callable[[Mesh, clothkit.Plan], Mesh]:
    """Return what executes a plan's first step in a simulated world; the plan is in the table's frame."""

    def follow(mesh: Mesh, plan: clothkit.Plan) -> Mesh:
        step = plan.steps[0]
        grasps = np.array([step.hands[0].grasp_m, step.hands[-1].grasp_m])[:, :2] / plan.metres_per_normalised
        move, single = np.array(step.manipulation[4:], np.float32), np.array([len(step.hands) == 1])
        cloths, settings = cloths_of(drawn, 1), drawn.simulation
        return execute(mesh[None], grasps[None], move[None], single, cloths, settings=settings, workers=1)[0]

    return follow


def picture(looks: list[Look], goal: Mesh, title: str, path: Path) -> None:
    """Draw a session, a row per look."""
    figure, axes = panels.sheet([1.0] * len(looks), [1.0] * len(HEADINGS), title=title, left=0.3, above=0.2)
    for column, name in enumerate(HEADINGS):
        panels.heading(axes[0, column], name)
    for look, (true, seen, estimate, expected) in zip(looks, axes, strict=True):
        panels.row_label(true, f"look {look.row['step']}")
        panels.show(true, draw(centred(look.mesh)[0]), note=_note(look.row, "error"))
        if look.voxels is not None and look.estimate is not None:
            panels.show(seen, draw_heights(look.voxels))
            panels.show(estimate, draw(look.estimate), note=_note(look.row, "estimated"))
        if look.plan is not None and look.plan.improves and look.estimate is not None:
            panels.manipulate(estimate, look.estimate, look.plan.manipulations[0])
            panels.show(expected, draw(look.plan.means[:, -1].mean(0)), note=_note(look.row, "expected"))
    panels.show(axes[-1, -1], draw(goal, table=panels.GOAL), note="goal")
    panels.save(figure, path)


def _note(row: dict[str, Any], name: str) -> str:
    return f"{row[name]:.3f}" if row.get(name) is not None else ""


def scale_of(data: Path) -> str:
    """Return the scale at which the nets in a folder were trained."""
    return read_manifest(data).scale if (data / MANIFEST).exists() else load_params(Path("params.yaml")).scale


def main() -> None:
    """Run the study and print how each session ended."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("repeats", type=int, nargs="?", default=2)
    parser.add_argument("--goal", choices=list(GOALS), default="half")
    parser.add_argument("--starts", choices=START_NAMES, nargs="+", default=START_NAMES)
    parser.add_argument("--sides", type=float, nargs=2, default=[0.5, 0.3], metavar="METRES")
    parser.add_argument("--thickness", type=float, default=0.005, metavar="METRES")
    parser.add_argument("--data", type=Path, default=Path("prebuilt/household"))
    parser.add_argument("--record", type=Path, metavar="FOLDER")
    asked = parser.parse_args()
    data, settings = load_nets(asked.data)
    table = CAMERA.table()
    agent = clothkit.Agent(
        data,
        settings=settings,
        sides=asked.sides,
        thickness=asked.thickness,
        table=(*table.normal.tolist(), table.offset),
        frame="table",
    )
    world, drawing = world_of(asked.sides, asked.thickness, settings.simulation), EvaluateGoalsConfig()
    folder = Path("reports") / scale_of(asked.data) / "studies"
    (folder / "closed_loop").mkdir(parents=True, exist_ok=True)
    rows = list[dict[str, Any]]()
    for start in asked.starts:
        for repeat in range(asked.repeats):
            mesh = centred(start_of(repeat, start, drawing, world).mesh)[0]
            see = camera_above(max(asked.sides), asked.thickness, seed=repeat)
            agent.begin(asked.goal, steps="auto")
            looks = play(agent, mesh, see, hands_in(cloth_of(repeat, drawing, world)))
            name, end = f"{start}_{repeat}", looks[-1].row["end"]
            title = f"{asked.goal}, {start} {repeat}: {end}"[:90]
            picture(looks, agent.state.target, title, folder / f"closed_loop/{name}.png")
            if asked.record is not None:
                asked.record.mkdir(parents=True, exist_ok=True)
                agent.record(asked.record / f"{name}.rrd")
            rows += [{"goal": asked.goal, "start": start, "repeat": repeat, **look.row} for look in looks]
            print(pd.DataFrame(rows[-len(looks) :]).drop(columns="notices", errors="ignore").round(3).to_string())
            # Session by session: what was found is kept if the study is ended.
            found = pd.DataFrame(rows).reindex(columns=COLUMNS)
            found.to_csv(folder / "closed_loop.csv", index=False, float_format="%.5g", lineterminator="\n")


if __name__ == "__main__":
    try:
        main()
    except InputError as refused:
        raise SystemExit(f"closed_loop: {refused}") from refused

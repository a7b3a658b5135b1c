"""ARCSim's scenes replayed in our solver: its start, its hands' motion, and what became of the cloth at its end."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.simulation.arcsim_obj import read_frame
from clothkit.simulation.arcsim_scene import read_paths
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.world import Motion, Worlds

POINTS = 257  # of a hand's path


class Scene(NamedTuple):
    """A scene of ARCSim's whose cloth is a grid."""

    name: str
    start: Float[np.ndarray, "u v 3"]
    """Metres."""
    final: Float[np.ndarray, "u v 3"]
    motion: Motion
    """In one world."""


class Replay(NamedTuple):
    """What our solver makes of a scene."""

    final: Float[np.ndarray, "u v 3"]
    """Metres, at ARCSim's last moment."""
    moments: Float[np.ndarray, " moments"]
    """s, since the grasp."""
    states: Float[np.ndarray, "moments u v 3"]
    cpu_seconds: float


def read(conf: Path) -> Scene | None:
    """The scene of NAME.conf.json, with NAME.start.obj and NAME.obj beside it; None when its cloth is no grid."""
    name = conf.name.removesuffix(".conf.json")
    start, final = (read_frame(conf.with_name(f"{name}{kind}.obj")) for kind in (".start", ""))
    side = round(len(start.positions) ** 0.5)
    if len(final.positions) != len(start.positions) or side**2 != len(start.positions):
        return None
    spacing = start.side / (side - 1)
    corner = np.rint((start.material - start.material.min(0)) / spacing).astype(int)
    vertex = corner[:, 0] * side + corner[:, 1]
    if len(set(vertex)) != len(vertex):
        return None
    order = np.argsort(vertex)
    grids = [frame.positions[order].reshape(side, side, 3) for frame in (start, final)]
    handles = read_paths(conf, np.zeros(1))
    end = max(handle.end for handle, _ in handles)
    handles = read_paths(conf, np.linspace(0, end, POINTS))
    held = np.full((1, 2, 1), -1)
    path = np.zeros((1, 2, POINTS, 3))
    for hand, (handle, moved) in enumerate(handles):
        held[0, hand, 0] = vertex[handle.node]
        path[0, hand] = start.positions[handle.node] + moved
    return Scene(name, *(grid.astype(np.float32) for grid in grids), Motion(held, path, np.array([end])))


def replay(scene: Scene, settings: SimulationConfig) -> Replay:
    """Run a scene. `settings.settling` says until when; CPU seconds are this process', without the compilation."""
    worlds = Worlds(1, settings)
    state = scene.start[None]
    worlds.begin(state, scene.motion)
    moments, states, spent = [], [], 0.0
    while not worlds.read("done", 1).all():
        started = time.process_time()
        worlds.advance(1)
        spent += time.process_time() - started
        moments.append(float(worlds.read("time", 1)[0]))
        states.append(worlds.read("position", 1).reshape(state.shape)[0])
    return Replay(states[-1], np.array(moments), np.array(states), spent)

"""Replay of ARCSim scenes in our solver, from the scene's first frame and hand motions to its end."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.regularise import interpolation
from clothkit.runtime.errors import InputError
from clothkit.simulation.arcsim_obj import Frame, read_frame
from clothkit.simulation.arcsim_scene import read_end, read_paths
from clothkit.simulation.settings import SimulationConfig
from clothkit.simulation.world import Motion, Worlds

POINTS = 257  # on a hand's path
HANDS = 2


class Scene(NamedTuple):
    """A scene of ARCSim, with its cloth interpolated at a grid of material points."""

    name: str
    start: Float[np.ndarray, "u v 3"]
    """The cloth in the first frame, in metres."""
    final: Float[np.ndarray, "u v 3"]
    """The cloth in the last frame, in metres."""
    motion: Motion
    """The hand motions, for one world."""
    end: float
    """End of the scene, in s."""


class Replay(NamedTuple):
    """The result of a scene in our solver."""

    times: Float[np.ndarray, " moments"]
    """Times since the grasp, in s."""
    states: Float[np.ndarray, "moments u v 3"]
    """States at these times, in metres; the last one is at the scene's end."""
    cpu_seconds: float

    @property
    def final(self) -> Float[np.ndarray, "u v 3"]:
        """The last state, in metres."""
        return self.states[-1]


def read_scene(conf: Path) -> Scene:
    """Read the scene of NAME.conf.json, with NAME.start.obj and NAME.obj in the same folder.

    Raises InputError if the hands do not hold at most two nodes from 0 s to one common release.
    """
    name = conf.name.removesuffix(".conf.json")
    start, final = (read_frame(conf.with_name(f"{name}{kind}.obj")) for kind in (".start", ""))
    release = max(handle.end for handle, _ in read_paths(conf, np.zeros(1)))
    handles = read_paths(conf, np.linspace(0, release, POINTS))
    if len(handles) > HANDS or any((handle.start, handle.end) != (0, release) for handle, _ in handles):
        raise InputError(f"{conf}: handles: expected at most two nodes, held from 0 s until they are let go together")
    held = np.full((1, HANDS, 1), -1)
    path = np.zeros((1, HANDS, POINTS, 3))
    for hand, (handle, moved) in enumerate(handles):
        distance = np.linalg.norm(SQUARE.geodesic() - start.geodesic(handle.node), axis=-1)
        held[0, hand, 0] = distance.argmin()
        path[0, hand] = start.positions[handle.node] + moved
    motion = Motion(held, path, np.array([release]))
    return Scene(name, _on_grid(start), _on_grid(final), motion, read_end(conf))


def replay(scene: Scene, settings: SimulationConfig) -> Replay:
    """Simulate a scene until `settings.settling` ends it; the CPU seconds are those of the solver only."""
    worlds = Worlds(1, settings)
    state = scene.start[None]
    times, states, spent = [], [], 0.0
    worlds.begin(state, scene.motion)
    while not worlds.read("done", 1).all():
        started = time.process_time()
        worlds.advance(1)
        spent += time.process_time() - started
        times.append(float(worlds.read("time", 1)[0]))
        states.append(worlds.read("position", 1).reshape(state.shape)[0])
    return Replay(np.array(times), np.array(states), spent)


def _on_grid(frame: Frame) -> Float[np.ndarray, "u v 3"]:
    grid = interpolation(frame.material, frame.triangles)(frame.positions)
    assert grid.shape == (*SQUARE.shape, 3)
    return grid.astype(np.float32)

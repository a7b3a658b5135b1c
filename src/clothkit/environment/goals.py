"""Goals and starts of episodes: a mesh, or what draws one."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.manipulation.sampling import draw_hands, sample
from clothkit.runtime.errors import InputError
from clothkit.simulation.executor import perform
from clothkit.simulation.quality import measure, reason
from clothkit.simulation.settings import SimulateConfig
from clothkit.simulation.world import Worlds

Mesh = Float[np.ndarray, "u v 3"]
"""Normalised; where it lies is of no importance for a goal."""

MeshSampler = Callable[[np.random.Generator], Mesh]
"""Draws a mesh [normalised] by a generator of random numbers: the same generator, the same mesh."""

TRIES = 100


class RandomFolds:
    """Draws what random folds make of the flat cloth, by the restrictions and limits of recorded sequences (4.4)."""

    def __init__(self, least: int, most: int, worlds: Worlds) -> None:
        """From `least` to `most` folds, each number as often, of the worlds' cloth."""
        self._least, self._most, self._worlds = least, most, worlds
        self._settings = SimulateConfig(sequences=1, simulation=worlds.settings)

    def __call__(self, rng: np.random.Generator) -> Mesh:
        """A mesh at its place on the table [normalised]. Raises InputError if no try was accepted."""
        folds = int(rng.integers(self._least, self._most + 1))
        for _ in range(TRIES):
            found = self._tried(rng, folds)
            if found is not None:
                return found
        raise InputError(f"goal: none of {TRIES} tries at {folds} random folds was accepted, is the grid too coarse?")

    def _tried(self, rng: np.random.Generator, folds: int) -> Mesh | None:
        settings, topology = self._settings, self._worlds.topology
        scale = np.float32(settings.simulation.cloth_side / CLOTH_LENGTH)
        mesh = topology.flat()
        for _ in range(folds):
            hands = draw_hands(rng, settings.sampling)
            move = sample(rng, mesh, hands, settings.sampling, settings.candidates, topology)
            if move is None:
                return None
            grasps = mesh.reshape(-1, 3)[list(move.vertices), :2] * scale
            displacement = (move.displacement * scale).astype(np.float32)
            states = (mesh * scale)[None]
            _, outcome = perform(self._worlds, states, grasps[None], displacement[None], np.array([move.single]))
            quality = measure(outcome.states, settings.simulation, topology)
            if reason(quality, outcome, settings, 0):
                return None
            mesh = outcome.states[0] / scale
        return mesh


def drawn(what: Mesh | MeshSampler, rng: np.random.Generator, shape: tuple[int, int], *, name: str) -> Mesh:
    """The mesh, or one that is drawn. Raises InputError unless it is finite and of the grid's shape."""
    mesh = np.asarray(what(rng) if callable(what) else what, np.float32)
    if mesh.shape != (*shape, 3):
        raise InputError(f"{name}: has shape {list(mesh.shape)}, expected a mesh {[*shape, 3]}, normalised")
    if not np.isfinite(mesh).all():
        raise InputError(f"{name}: has vertices that are not finite")
    return mesh

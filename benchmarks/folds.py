"""What do simple folds look like?  python benchmarks/folds.py [--picture PNG] [--csv FOLDER]

A cloth of each material is folded in half by two hands, simulated for ten more seconds, and folded again into a quarter
by hands that grasp all layers. The table has lengths in mm: the height of the crest; the distance of touching layers
(ideally the material's thickness); the largest motion of a vertex in the ten seconds; and the mean distance between the
half fold and the one simulated with half the time step, and with half the time step and half the grid spacing.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import matplotlib
import numpy as np
from tables import show

from clothkit.simulation.executor import place_hands
from clothkit.simulation.kernels.state import PATH
from clothkit.simulation.material import FABRICS, Material
from clothkit.simulation.settings import Settling, SimulationConfig
from clothkit.simulation.solver import flat_state
from clothkit.simulation.world import Motion, Outcome, Worlds, arcs

matplotlib.use("Agg")
import matplotlib.pyplot as plt

MOVE = 0.37  # m, so that the moved edge ends slightly inside the edge below
WATCHED = 10.0  # s, simulated after the half fold
NOTHING = Motion(np.full((1, 2, 1), -1), np.zeros((1, 2, int(PATH), 3)), np.array([1e-3]))


def half_fold(settings: SimulationConfig) -> Outcome:
    """Fold the flat cloth with two hands, which move one edge along x over the opposite edge."""
    flat = flat_state(settings)
    held = np.array([[[0], [settings.side - 1]]])
    releases = flat[None, 0, [0, -1], :2] + [MOVE, 0.0]
    return Worlds(1, settings).execute(flat[None], arcs(flat[None], held, releases, settings))


def quarter_fold(half: np.ndarray, settings: SimulationConfig) -> Outcome:
    """Fold the half fold again along y with two hands that grasp all layers, near its free edges and near its ridge."""
    settings = dataclasses.replace(settings, grasp="all")
    hands = place_hands(half, half[[1, 12], 0, :2].astype(float), np.array([0.0, MOVE]), False, settings)
    return Worlds(1, settings).execute(
        half[None], arcs(half[None], hands.vertices[None], hands.releases[None], settings)
    )


def millimetres(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distance of each vertex between two states, in mm."""
    return np.linalg.norm(a - b, axis=-1) * 1e3


def measure(name: str, material: Material) -> tuple[dict, np.ndarray, np.ndarray]:
    """Return a material's row of the table and the states of its half and quarter fold."""
    settings = SimulationConfig(material=material)
    started = time.process_time()
    half = half_fold(settings)
    seconds = time.process_time() - started
    patient = dataclasses.replace(settings, settling=Settling(rest_time=WATCHED, longest=WATCHED + 1))
    later = Worlds(1, patient).execute(half.states, NOTHING)
    quarter = quarter_fold(half.states[0], settings)
    smaller = dataclasses.replace(settings, time_step=settings.time_step / 2)
    finer = dataclasses.replace(smaller, side=2 * settings.side - 1)
    state, fold = half.states[0], quarter.states[0]
    layers = [fold[-10:-4, -10:-4], fold[4:10, -10:-4], fold[4:10, 4:10], fold[-10:-4, 4:10]]
    row = {
        "material": name,
        "half: rested": bool(half.rested[0]),
        "crest": round(float(state[..., 2].max()) * 1e3, 1),
        "layers apart": round(float((state[1:11, :, 2] - state[:-12:-1, :, 2][1:]).mean()) * 1e3, 2),
        "moved in 10 s": round(float(millimetres(later.states[0], state).max()), 2),
        "half the step": round(float(millimetres(half_fold(smaller).states[0], state).mean()), 1),
        "and spacing": round(float(millimetres(half_fold(finer).states[0, ::2, ::2], state).mean()), 1),
        "quarter: rested": bool(quarter.rested[0]),
        "crest ": round(float(fold[..., 2].max()) * 1e3, 1),
        "four layers at": [round(float(layer[..., 2].mean()) * 1e3, 1) for layer in layers],
        "CPU s, half": round(seconds, 2),
    }
    return row, state, fold


def draw(path: Path, folds: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Draw, per material, profiles and heights from above of the half fold and the quarter fold, in mm."""
    figure, axes = plt.subplots(len(folds), 4, figsize=(14, 3.1 * len(folds)), squeeze=False, layout="constrained")
    for row, (name, states) in zip(axes, folds.items(), strict=True):
        for side, above, state, fold in zip(row[::2], row[1::2], states, ("half fold", "quarter fold"), strict=True):
            mm = state * 1e3
            across = mm[:, 8] if fold == "half fold" else mm[8]
            side.plot(across[:, 0 if fold == "half fold" else 1], across[:, 2], ".-", linewidth=1)
            side.set(title=f"{name}, {fold}: profile, mm", ylim=(0, 40))
            shown = above.scatter(mm[..., 0], mm[..., 1], c=mm[..., 2], s=6, vmin=0, vmax=20, cmap="viridis")
            above.set(title="from above, mm", aspect="equal", xlim=(-60, 260), ylim=(-220, 260))
            figure.colorbar(shown, ax=above, label="z, mm")
    figure.savefig(path, dpi=100)


def main() -> None:
    """Print the table, and write the picture and the CSV file if asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    half_fold(SimulationConfig(settling=Settling(rest_time=0.05)))  # compiles
    rows, folds = [], {}
    for name, material in {"default": Material(), **FABRICS}.items():
        row, half, quarter = measure(name, material)
        rows.append(row)
        folds[name] = (half, quarter)
    show("folds", rows, csv=asked.csv)
    if asked.picture:
        draw(asked.picture, folds)


if __name__ == "__main__":
    main()

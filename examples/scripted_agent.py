"""A scripted agent in `clothkit/Fold-v0`: it folds a flat cloth into a named goal by the goal's own manipulations.

./run python examples/scripted_agent.py quarter
"""

import sys

import gymnasium
import numpy as np

import clothkit.environment
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.goals.making import careful
from clothkit.goals.store import made, user_folder
from clothkit.simulation.settings import SimulationConfig


def script(name: str, simulation: SimulationConfig) -> np.ndarray:
    """The actions [step, 6] that make a named goal of the flat cloth: u1 v1 u2 v2, dx dy in cloth lengths."""
    moves = made(name, simulation.topology, simulation, folder=user_folder()).manipulations
    return (moves / np.array([1, 1, 1, 1, CLOTH_LENGTH, CLOTH_LENGTH])).astype(np.float32)


def play(env: gymnasium.Env, actions: np.ndarray) -> tuple[float, float]:
    """The sum of the rewards, and the error in the end, of an episode."""
    _, info = env.reset(seed=0)
    total = 0.0
    for action in actions:
        _, reward, terminated, _, info = env.step(action)
        total += float(reward)
        if terminated:
            break
    return total, float(info["error"])


if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "quarter"
    # Hands that are slow and grasp all layers, as those that made the goal.
    simulation = careful(SimulationConfig())
    env = gymnasium.make(clothkit.environment.ID, goal=name, simulation=simulation)
    print("{}: reward {:.3f}, error {:.3f} in the end".format(name, *play(env, script(name, simulation))))

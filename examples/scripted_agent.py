"""A scripted agent in `clothkit/Fold-v0`: it folds a cloth in quarters, the one goal that it knows.

./run python examples/scripted_agent.py
"""

import gymnasium
import numpy as np

import clothkit.environment
from clothkit.simulation.settings import SimulationConfig

SCRIPT = np.array([[1, -1, 1, 1, -0.95, 0], [-1, 1, 0, 1, 0, -0.95]], np.float32)
"""Two corners to the opposite edge, twice: u1 v1 u2 v2 on the cloth, dx dy in cloth lengths."""


def made(simulation: SimulationConfig) -> gymnasium.Env:
    """The environment with what the script makes of the flat cloth as its goal."""
    env = gymnasium.make(clothkit.environment.ID, steps=len(SCRIPT), simulation=simulation)
    play(env, goal=simulation.topology.flat())
    return gymnasium.make(
        clothkit.environment.ID, steps=len(SCRIPT), simulation=simulation, goal=env.get_wrapper_attr("mesh")
    )


def play(env: gymnasium.Env, *, goal: np.ndarray | None = None) -> tuple[float, float]:
    """The sum of the rewards, and the error in the end, of an episode by the script [cloth length]."""
    _, info = env.reset(seed=0, options=None if goal is None else {"goal": goal})
    total = 0.0
    for action in SCRIPT:
        _, reward, _, _, info = env.step(action)
        total += float(reward)
    return total, float(info["error"])


if __name__ == "__main__":
    # Hands grasp all layers: the second fold is one of two.
    print("reward {:.3f}, error {:.3f} in the end".format(*play(made(SimulationConfig(grasp="all")))))

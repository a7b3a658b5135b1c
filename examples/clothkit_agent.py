"""`clothkit.Agent` in `clothkit/Fold-v0`: it sees voxels of the cloth, plans, and has its plans executed.

./run python examples/clothkit_agent.py                # half; with nets under data/, or the prebuilt ones
./run python examples/clothkit_agent.py corners-in     # needs more manipulations than are planned at once
"""

import sys

import gymnasium
import numpy as np

import clothkit
import clothkit.environment
from clothkit.dataset.store import STEPS


def play(env: gymnasium.Env, agent: clothkit.Agent, *, seed: int) -> tuple[float, float]:
    """The errors in the end and at first of an episode [cloth length]."""
    if env.get_wrapper_attr("viewport") != agent.viewport:
        raise clothkit.InputError("play: the agent's nets read voxels of another viewport than the environment's")
    seen, info = env.reset(seed=seed)
    # The agent knows named goals; of another one it gets voxels, too.
    goal = info["goal_name"] or seen["goal"].astype(bool)
    agent.begin(goal, steps=min(int(seen["left"][0]), STEPS))
    over = False
    while not over:
        if not agent.left:
            # More manipulations than are planned at once: another session, for the goal as it was laid at first.
            agent.begin(agent.state.goal, steps=min(int(seen["left"][0]), STEPS))
        agent.observe(seen["cloth"].astype(bool))
        plan = agent.plan(seed=seed)
        action = action_of(plan, seen["centre"]) if plan.expected.improves else np.zeros(6, np.float32)
        seen, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    return float(info["error"]), float(info["error_start"])


def action_of(plan: clothkit.Plan, centre: np.ndarray) -> np.ndarray:
    """A plan's first step as an action with grasp points on the table, in cloth lengths.

    The voxels are centred, and so is the plan; `centre` is where the cloth's centre is.
    """
    step = plan.steps[0]
    if step.null:
        return np.zeros(6, np.float32)
    grasps = np.array([step.hands[0].grasp_m, step.hands[-1].grasp_m])[:, :2] / plan.side_m + centre
    displacement = np.array(step.manipulation[4:]) * plan.metres_per_normalised / plan.side_m
    return np.clip([*grasps.ravel(), *displacement], -1, 1).astype(np.float32)


if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "half"
    agent = clothkit.Agent("data")
    # The nets tell heights by the voxels' viewport.
    env = gymnasium.make(
        clothkit.environment.ID, goal=name, start="dragged", observation="voxels", viewport=agent.viewport
    )
    for seed in range(3):
        error, start = play(env, agent, seed=seed)
        print(f"episode {seed}: error {error:.3f}, {start:.3f} at first")

"""A random agent in `clothkit/Fold-v0`: what chance comes to.

./run python examples/random_agent.py
"""

import gymnasium

import clothkit.environment


def play(env: gymnasium.Env, *, episodes: int, seed: int) -> list[float]:
    """The errors in the end, one for each episode; actions are drawn uniformly [cloth length]."""
    env.action_space.seed(seed)
    errors = []
    for episode in range(episodes):
        _, info = env.reset(seed=seed + episode)
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(env.action_space.sample())
            over = terminated or truncated
        print(f"episode {episode}: error {info['error']:.3f}, {info['error_start']:.3f} at first")
        errors.append(float(info["error"]))
    return errors


if __name__ == "__main__":
    play(gymnasium.make(clothkit.environment.ID, goal=("half", "triangle"), start="flat", steps=2), episodes=5, seed=0)

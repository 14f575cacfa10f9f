"""`BinPickSelect-v0`: one decision a step. The rule here takes the highest part, gripped as vertically as possible."""

import gymnasium as gym
import numpy as np

import binpick_env  # noqa: F401 - registers the environments
from policies.selection.features import column


def main(num_parts: int = 4, decisions: int = 3) -> list[str]:
    """Return the outcomes of the first decisions."""
    env = gym.make("BinPickSelect-v0", part="tee", num_parts=num_parts, perception="oracle")
    observation, _ = env.reset(seed=0)
    outcomes = []
    for _ in range(decisions):
        grasps, mask = observation["grasps"], observation["mask"]
        score = grasps[:, column("top")] + 0.5 * grasps[:, column("vertical")]
        action = int(np.argmax(np.where(mask == 1, score, -np.inf)))
        observation, reward, terminated, truncated, info = env.step(action)
        outcomes.append(info["outcome"])
        print(
            f"row {action}: {info['outcome']}, reward {reward:+.1f}, {info['delivered']} of {info['total']} delivered"
        )
        if terminated or truncated:
            break
    env.close()
    return outcomes


if __name__ == "__main__":
    main(num_parts=10, decisions=10)

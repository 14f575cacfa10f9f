"""Reset and step the cell, and read what perception offers."""

import gymnasium as gym

import binpick_env  # registers BinPick-v0 and BinPickSelect-v0
from binpick_env.candidates import FEATURES


def main(num_parts: int = 6, steps: int = 10) -> int:
    """Return the number of candidates in the first observation."""
    env = gym.make("BinPick-v0", part="tee", num_parts=num_parts, perception="oracle")
    observation, info = env.reset(seed=0)
    candidates = observation["candidates"][observation["candidate_mask"] == 1]
    print(
        f"{len(candidates)} of {info['total']} parts are offered, each with {len(FEATURES)} numbers: {FEATURES[:4]} ..."
    )
    home = observation["joint_pos"]
    for _ in range(steps):  # hold the arm where it is, with the jaw open
        observation, _, terminated, truncated, info = env.step([*home, 0.0])
    print(f"after {steps} steps of 0.04 s: {info['remaining']} parts in play, ended: {terminated or truncated}")
    env.close()
    return len(candidates)


if __name__ == "__main__":
    print(f"binpick_env registers {', '.join(name for name in gym.registry if name.startswith('BinPick'))}")
    assert binpick_env.__doc__
    main()

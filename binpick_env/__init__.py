"""The simulated bin-picking cell. Importing it registers ``BinPick-v0`` and ``BinPickSelect-v0`` with Gymnasium."""

import gymnasium as gym

gym.register(
    id="BinPick-v0",
    entry_point="binpick_env.env:BinPickEnv",
    max_episode_steps=12_000,
)
gym.register(
    id="BinPickSelect-v0",
    entry_point="policies.selection.env:GraspSelectionEnv",  # loaded when it is made
    max_episode_steps=200,
)

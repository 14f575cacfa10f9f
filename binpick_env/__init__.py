"""The simulated bin-picking cell. Importing it registers ``BinPick-v0`` and ``BinPickSelect-v0`` with Gymnasium."""

import gymnasium as gym
import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)

gym.register(
    id="BinPick-v0",
    entry_point="binpick_env.env:BinPickEnv",
    max_episode_steps=12_000,
)
# The only place where this package names `policies`, which depends on it and not the other way round: Gymnasium has one
# registry, and whoever makes an environment imports `binpick_env`. The string is resolved when the environment is made.
gym.register(
    id="BinPickSelect-v0",
    entry_point="policies.selection.env:GraspSelectionEnv",
    max_episode_steps=200,
)

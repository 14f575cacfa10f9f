"""Episodes that can be played again: each has a seed of its own, so that seed and actions determine it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv


def episode_seed(series: int, number: int) -> int:
    """Return the seed of an episode: numpy's ``SeedSequence`` over the seed of its series and its number in it."""
    return int(np.random.SeedSequence([series, number]).generate_state(1)[0])


class SeededEpisodes(gym.Wrapper[Any, Any, Any, Any]):
    """Resets each episode with a seed of its own.

    ``reset(seed)`` begins a series with episode 0, and each reset without a seed begins the next episode. An episode
    therefore depends on nothing that happened in those before it. Without any seed, resets are passed on unchanged.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self._series: int | None = None
        self._next = 0  # number of the episode that the next reset begins

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the first episode of a series, or the next one."""
        if seed is not None:
            self.skip_to(seed, 0)
        if self._series is None:
            return self.env.reset(options=options)
        number, self._next = self._next, self._next + 1
        return self.env.reset(seed=episode_seed(self._series, number), options=options)

    def skip_to(self, series: int, number: int) -> None:
        """Let the next reset begin an episode of a series."""
        self._series, self._next = series, number


@dataclass(frozen=True, kw_only=True)
class Episode:
    """What the present state of an environment follows from.

    Attributes:
        series: Seed of the series.
        number: Number of the episode in the series.
        options: Options of its reset.
        actions: Actions so far, each (1,) as the vector of one environment takes it.
    """

    series: int
    number: int = 0
    options: dict[str, Any] = field(default_factory=dict)
    actions: tuple[NDArray[Any], ...] = ()

    def after(self, action: NDArray[Any], over: bool) -> "Episode":
        """Return the episode after a step, which is the next one if this one is over."""
        if over:
            return Episode(series=self.series, number=self.number + 1)
        return replace(self, actions=(*self.actions, action))


class ReplayableEnv:
    """One environment with what SB3's vectors do around it, which can be brought to the state of another one.

    Args:
        maker: Makes the environment, one of whose wrappers is a :class:`SeededEpisodes`.
    """

    def __init__(self, maker: Callable[[], gym.Env[Any, Any]]) -> None:
        self._vector = DummyVecEnv([maker])  # whose arrays have a first axis of length 1

    def spaces(self) -> tuple[gym.Space[Any], gym.Space[Any]]:
        """Return the spaces of observations and of actions."""
        return self._vector.observation_space, self._vector.action_space

    def reset(self, seed: int | None, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; return observation and info."""
        if seed is not None:
            self._vector.seed(seed)
        self._vector.set_options(options)
        return self._vector.reset(), self._vector.reset_infos[0]

    def step(self, action: NDArray[Any]) -> tuple[Any, NDArray[Any], NDArray[Any], dict[str, Any], dict[str, Any]]:
        """Return observation, reward, whether the episode was over, info, and the info of the last reset."""
        observation, reward, done, (info,) = self._vector.step(action)
        return observation, reward, done, info, self._vector.reset_infos[0]

    def env_method(self, name: str, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """Call a method of the environment or of a wrapper around it."""
        return self._vector.env_method(name, *arguments, **named)[0]

    def get_attr(self, name: str) -> Any:
        """Return an attribute of the environment or of a wrapper around it."""
        return self._vector.get_attr(name)[0]

    def has_attr(self, name: str) -> bool:
        """Tell whether the environment or a wrapper around it has an attribute."""
        return self._vector.has_attr(name)

    def is_wrapped(self, wrapper: type[gym.Wrapper[Any, Any, Any, Any]]) -> bool:
        """Tell whether the environment is wrapped with a kind of wrapper."""
        return self._vector.env_is_wrapped(wrapper)[0]

    def resume(self, episode: Episode | None, method: str, arguments: tuple[Any, ...]) -> tuple[Any, Any]:
        """Play an episode so far, if any has begun, then call another method.

        Returns:
            The last observation of the episode, None if there is no episode, and the result of the method.
        """
        observation = None
        if episode is not None:
            self._vector.env_method("skip_to", episode.series, episode.number)
            observation, _ = self.reset(None, episode.options)
            for action in episode.actions:
                observation, *_ = self.step(action)
        return observation, getattr(self, method)(*arguments)

"""A vector whose environments are lost now and then gives what SB3's own vector gives."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from binpick_env.jobs.cluster_job import Outcome
from binpick_env.jobs.workers import WorkerError
from policies.selection.learning.cluster_vec_env import ClusterVecEnv
from policies.selection.learning.episodes import ReplayableEnv, SeededEpisodes
from tests.policies.selection.learning.toy_selection import PARTS, ToySelection


def maker() -> Monitor:
    return Monitor(SeededEpisodes(ToySelection()))


class Here:
    """Keeps environments in this process, makes each call at once, and loses environments as it is told."""

    def __init__(self, losses: dict[int, set[int]] | None = None) -> None:
        self.made, self.closed, self._asked = 0, False, 1
        self._losses = losses or {}  # numbers of the calls over which an environment is lost, by its index
        self._counts: dict[int, int] = {}
        self._envs: dict[int, ReplayableEnv] = {}
        self._outcomes: list[tuple[int, Outcome | None]] = []

    def call(self, index: int, method: str, *arguments: Any) -> None:
        self._counts[index] = self._counts.get(index, -1) + 1
        if index not in self._envs:
            self._envs[index] = ReplayableEnv(maker)
            self.made += 1
        result = getattr(self._envs[index], method)(*arguments)
        if self._counts[index] in self._losses.get(index, ()):  # the call was made, but its result is lost
            del self._envs[index]
            self._outcomes.append((index, None))
        else:
            self._outcomes.append((index, Outcome(result=result, files={})))

    def finished(self) -> Iterator[tuple[int, Outcome | None]]:
        """Yield no outcome at every second call, else one, the last one first."""
        self._asked += 1
        if self._asked % 2:
            yield self._outcomes.pop()

    def close(self) -> None:
        self.closed = True


def played(vector: VecEnv, steps: int = 3 * PARTS) -> list[Any]:
    """Return everything that a vector gives, each action from the masks before it."""
    vector.seed(11)
    seen: list[Any] = [vector.reset()]
    for _ in range(steps):
        masks = get_action_masks(vector)
        observations, rewards, dones, infos = vector.step(np.array([np.flatnonzero(mask)[-1] for mask in masks]))
        for info in infos:
            info.get("episode", {}).pop("t", None)  # wall clock
        seen.append((masks, observations, rewards, dones, list(infos), list(vector.reset_infos)))
    return seen


EXPECTED = played(DummyVecEnv([maker] * 2))


def test_without_a_loss_all_is_the_same() -> None:
    objects = Here()
    vector = ClusterVecEnv(objects, 2)
    np.testing.assert_equal(played(vector), EXPECTED)
    assert objects.made == 2
    vector.close()
    assert objects.closed


@pytest.mark.parametrize("call", range(14))
def test_a_loss_over_any_call_changes_nothing(call: int) -> None:
    """Two calls make a vector, one resets it, then masks and steps alternate."""
    objects = Here({0: {call}, 1: {call + 1, call + 2}})
    np.testing.assert_equal(played(ClusterVecEnv(objects, 2)), EXPECTED)
    assert objects.made == 5


def test_losses_are_counted_over_one_call() -> None:
    """Three in a row are no end, and are forgotten once the call has succeeded."""
    objects = Here({1: {6, 7, 8, 10, 11, 12}})
    np.testing.assert_equal(played(ClusterVecEnv(objects, 2)), EXPECTED)
    with pytest.raises(WorkerError, match="a step of environment 1 was given up, since 4 workers were lost over it"):
        played(ClusterVecEnv(Here({1: {6, 7, 8, 9}}), 2))


def test_a_second_reset_begins_the_next_episode_and_options_are_played_again(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []
    reset = ToySelection.reset

    def noted(self: ToySelection, *, seed: int | None = None, options: Any = None) -> Any:
        given.append((seed, options))
        return reset(self, seed=seed, options=options)

    monkeypatch.setattr(ToySelection, "reset", noted)
    vector = ClusterVecEnv(Here({0: {4, 6 + PARTS}}), 1)
    vector.seed(11)
    vector.reset()
    vector.set_options({"num_parts": 3})
    vector.reset()
    vector.step(np.array([0]))
    assert given == [given[0], given[1], given[1]]  # the third one is the replay
    assert given[0][1] is None
    assert given[1][1] == {"num_parts": 3}
    assert given[0][0] != given[1][0]
    for _ in range(PARTS + 1):
        vector.step(np.array([0]))
    assert given[3:] == 2 * [(given[3][0], None)]  # options are those of one episode


def test_a_vector_without_a_seed_draws_one() -> None:
    vector = ClusterVecEnv(Here({0: {3}}), 1)
    vector.reset()
    vector.step(np.array([0]))


def test_an_environment_that_computes_other_bits_is_no_replacement(monkeypatch: pytest.MonkeyPatch) -> None:
    vector = ClusterVecEnv(Here({0: {4}}), 1)
    vector.seed(11)
    vector.reset()
    vector.step(np.array([0]))
    observe = ToySelection._observe

    def other(self: ToySelection) -> dict[str, np.ndarray]:
        observation = observe(self)
        observation["grasps"][0, 0] += np.float32(1e-6)
        return observation

    monkeypatch.setattr(ToySelection, "_observe", other)
    with pytest.raises(WorkerError, match=r"environment 0 cannot go on, since the worker .* computes other bits"):
        vector.step(np.array([0]))


def test_environments_are_asked_and_not_set() -> None:
    vector = ClusterVecEnv(Here(), 2)
    assert is_masking_supported(vector)
    assert not vector.has_attr("opened")
    assert vector.get_attr("closed", indices=1) == [False]
    assert vector.env_is_wrapped(SeededEpisodes) == [True, True]
    assert vector.env_is_wrapped(gym.wrappers.TimeLimit, indices=[0]) == [False]
    with pytest.raises(NotImplementedError, match="attributes of environments on a cluster cannot be set"):
        vector.set_attr("closed", True)

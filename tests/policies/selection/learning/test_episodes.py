"""An episode follows from its seed and its actions, whatever was played before."""

from typing import Any

import numpy as np

from policies.selection.learning.episodes import Episode, ReplayableEnv, SeededEpisodes, episode_seed
from tests.policies.selection.learning.toy_selection import PARTS, ToySelection


def wrapped() -> SeededEpisodes:
    return SeededEpisodes(ToySelection())


def grasps(env: Any, seed: int | None = None) -> bytes:
    observation, _ = env.reset(seed=seed)
    return bytes(observation["grasps"].tobytes())


def test_an_episode_is_that_of_its_series_and_number() -> None:
    env, other = wrapped(), wrapped()
    first = [grasps(env, 7), *(grasps(env) for _ in range(3))]
    assert len(set(first)) == 4
    expected = grasps(other, 7)
    for _ in range(5):
        other.step(np.int64(0))  # which draws random numbers
    assert [expected, *(grasps(other) for _ in range(3))] == first
    other.skip_to(7, 2)
    assert [grasps(other), grasps(other), grasps(other, 7)] == [first[2], first[3], first[0]]
    plain = ToySelection()
    assert [grasps(plain, episode_seed(7, k)) for k in range(4)] == first
    assert not {grasps(env, 8), grasps(env)} & set(first)


def test_options_arrive_and_without_a_seed_nothing_is_seeded() -> None:
    given: list[tuple[int | None, Any]] = []

    class Noted(ToySelection):
        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            given.append((seed, options))
            return super().reset(seed=seed, options=options)

    env = SeededEpisodes(Noted())
    env.reset(options={"num_parts": 3})
    env.reset(seed=5, options={"num_parts": 4})
    assert given == [(None, {"num_parts": 3}), (episode_seed(5, 0), {"num_parts": 4})]


def test_an_episode_is_resumed_with_the_same_bits() -> None:
    """The second one of a series, in its middle."""
    env, episode, action = ReplayableEnv(wrapped), Episode(series=3), np.array([0])
    env.reset(3, {})
    for _ in range(PARTS + 2):
        observation, _, done, *_ = env.step(action)
        episode = episode.after(action, done[0])
    assert (episode.series, episode.number, episode.actions) == (3, 1, (action, action))
    again = ReplayableEnv(wrapped)
    replayed, answer = again.resume(episode, "step", (action,))
    np.testing.assert_equal(replayed, observation)
    np.testing.assert_equal(answer, env.step(action))
    for _ in range(PARTS):
        np.testing.assert_equal(again.step(action), env.step(action))


def test_an_environment_without_an_episode_only_answers() -> None:
    assert ReplayableEnv(wrapped).resume(None, "has_attr", ("action_masks",)) == (None, True)


def test_attributes_and_wrappers_are_seen_through() -> None:
    env = ReplayableEnv(wrapped)
    env.reset(1, {})
    assert env.is_wrapped(SeededEpisodes)
    assert env.get_attr("closed") is False
    assert not env.has_attr("opened")
    assert env.env_method("action_masks", (), {}).dtype == bool

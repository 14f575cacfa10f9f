"""``BinPick-v0``: Gymnasium's and SB3's contracts, and repeatability."""

import inspect
import os
import pickle
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RescaleAction

import binpick_env  # noqa: F401  registers the id
from binpick_env import env as env_module
from binpick_env.cell.robot import HOME
from binpick_env.config import BinConfig, CellConfig
from binpick_env.env import MAX_EPISODE_STEPS, BinPickEnv
from binpick_env.observation.oracle import PoseNoise
from binpick_env.parts import load_part
from tests.binpick_env.small_cell import REST, SMALL, act, assert_same, random_actions, small_env

# SB3 warns that unnormalised actions and the candidates' 2-D array are unusual; both are meant.
NORMALISED = "We recommend you to use a symmetric and normalized Box action space"
TWO_DIMENSIONAL = "Your observation candidates has an unconventional shape"
GYM_NORMALISED = ".*For Box action spaces, we recommend using a symmetric and normalized space"


# --- contracts


@pytest.mark.filterwarnings(f"ignore:{GYM_NORMALISED}:UserWarning")
def test_gymnasiums_checker_with_images() -> None:
    env = small_env(obs_mode="rgbd")
    check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.slow
@pytest.mark.filterwarnings(f"ignore:{GYM_NORMALISED}:UserWarning")
def test_gymnasiums_checker(monkeypatch: pytest.MonkeyPatch) -> None:
    # It makes every declared mode; the viewer is not to be had without a display, which test_render.py is about.
    monkeypatch.setitem(BinPickEnv.metadata, "render_modes", ["rgb_array", "depth_array"])
    env = gym.make("BinPick-v0", **SMALL).unwrapped
    check_env(env)
    env.close()


@pytest.mark.filterwarnings(f"ignore:{NORMALISED}:UserWarning", f"ignore:{TWO_DIMENSIONAL}:UserWarning")
def test_sb3s_checker() -> None:
    from stable_baselines3.common.env_checker import check_env as check_sb3

    env = small_env()
    check_sb3(env)
    env.close()


@pytest.mark.parametrize("name", ["BinPick-v0", "binpick_env:BinPick-v0"])
def test_gym_makes_it(name: str) -> None:
    env = gym.make(name, **SMALL)
    assert isinstance(env.unwrapped, BinPickEnv)
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert info["total"] == 3
    env.close()


def test_the_registration_truncates() -> None:
    spec = gym.spec("BinPick-v0")
    assert spec.max_episode_steps == MAX_EPISODE_STEPS == 12_000
    env = gym.make("BinPick-v0", max_episode_steps=3, **SMALL)
    env.reset(seed=0)
    assert [truncated for *_, truncated, _ in act(env, 3 / 25)] == [False, False, True]
    env.close()


def test_truncated_when_the_registrations_steps_are_used_up(env: BinPickEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(env_module, "MAX_EPISODE_STEPS", 2)
    told = []
    for _ in range(2):
        *_, truncated, _ = env.step(REST)
        told.append((env.truncated, truncated))
    assert told == [(False, False), (True, False)]  # the wrapper truncates, not the environment


def test_actions_are_rescaled_for_learning() -> None:
    env = RescaleAction(gym.make("BinPick-v0", **SMALL), np.float32(-1), np.float32(1))
    observation, _ = env.reset(seed=0)
    low, high = env.unwrapped.action_space.low, env.unwrapped.action_space.high  # type: ignore[attr-defined]
    rest = 2 * (REST - low) / (high - low) - 1
    for _ in range(10):
        observation, *_ = env.step(rest.astype(np.float32))
    np.testing.assert_allclose(observation["joint_pos"], HOME, atol=1e-3)
    np.testing.assert_array_equal(env.action_space.low, -1.0)  # type: ignore[attr-defined]
    env.close()


def test_the_action_space_is_the_arms() -> None:
    env = small_env()
    limits = np.array([2 * np.pi] * 2 + [np.pi] + [2 * np.pi] * 3)
    np.testing.assert_allclose(env.action_space.low, [*-limits, 0], rtol=1e-4)
    np.testing.assert_allclose(env.action_space.high, [*limits, 1], rtol=1e-4)
    assert env.metadata["render_fps"] == 25


def test_the_docstring_describes_every_argument_and_observation(shared_env: BinPickEnv) -> None:
    text = inspect.cleandoc(BinPickEnv.__doc__ or "")  # from Python 3.13 on the compiler takes the indentation off
    assert set(re.findall(r"^\| `(\w+)` \|", text, flags=re.MULTILINE)) >= set(inspect.signature(BinPickEnv).parameters)
    assert all(f"`{key}`" in text for key in shared_env._boxes)


@pytest.mark.slow
def test_sb3_runs_a_copy_in_a_process() -> None:
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    vector = make_vec_env(
        "binpick_env:BinPick-v0",
        n_envs=1,
        seed=4,
        env_kwargs=SMALL,
        vec_env_cls=SubprocVecEnv,
        vec_env_kwargs={"start_method": "forkserver"},
    )
    observation = vector.reset()
    assert {key: value.shape[0] for key, value in observation.items()} == dict.fromkeys(observation, 1)
    for _ in range(3):
        observation, rewards, dones, infos = vector.step(REST[None])
    vector.close()
    assert rewards.tolist() == [0.0]
    assert not dones.any()
    assert [info["total"] for info in infos] == [3]
    alone = small_env()  # the worker's bits are this process's
    expected, _ = alone.reset(seed=4)
    np.testing.assert_array_equal(observation["candidates"][0], expected["candidates"])


def test_nothing_warns() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make("BinPick-v0", **SMALL)
        env.reset(seed=0)
        env.step(REST)
        env.close()


# --- repeatability


def differ(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> bool:
    return any(np.any(first[key] != second[key]) for key in first)


@pytest.mark.slow
def test_two_copies_stay_equal() -> None:
    """Bit for bit through a rollout, although one of them has another episode behind it."""
    first, second = small_env(), small_env()
    second.reset(seed=77)
    for action in random_actions(second, 20, seed=1):
        second.step(action)
    actions = random_actions(first, 80)
    for seed in (3, None, 3):
        starts = [env.reset(seed=seed) for env in (first, second)]
        assert_same(starts[0][0], starts[1][0])
        assert starts[0][1] == starts[1][1]
        for action in actions:
            steps = [env.step(action) for env in (first, second)]
            assert_same(steps[0][0], steps[1][0])
            assert steps[0][1:] == steps[1][1:]


def test_resetting_with_the_same_seed_after_another(shared_env: BinPickEnv) -> None:
    first, _ = shared_env.reset(seed=8)
    frame = shared_env.frame.depth
    other, _ = shared_env.reset(seed=9)
    again, _ = shared_env.reset(seed=8)
    assert_same(first, again)
    np.testing.assert_array_equal(shared_env.frame.depth, frame)
    assert differ(first, other)
    following, _ = shared_env.reset()
    assert differ(again, following)


def test_seed_zero_is_a_seed(shared_env: BinPickEnv) -> None:
    assert_same(shared_env.reset(seed=0)[0], shared_env.reset(seed=0)[0])


def test_gymnasium_films_it(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    from gymnasium.wrappers import RecordVideo

    films = tmp_path / "films"  # the wrapper warns of a folder that exists
    env = RecordVideo(small_env(render_mode="rgb_array", num_parts=1), str(films), episode_trigger=lambda _: True)
    env.reset(seed=0)
    for _ in range(2):
        env.step(REST)
    env.close()
    assert [path.suffix for path in films.iterdir()] == [".mp4"]


def test_a_pickled_copy_behaves_the_same() -> None:
    config = replace(CellConfig(), bin=BinConfig(inner_size=(0.3, 0.24, 0.12)))
    noise = PoseNoise(translation=0.002, rotation=0.05)
    env = small_env(num_parts=(2, 4), pose_noise=noise, config=config, sensor="harsh", obs_mode="rgbd")
    env.reset(seed=1)
    env.step(REST)
    copy = pickle.loads(pickle.dumps(env))
    assert copy.config == env.config
    assert copy.observation_space == env.observation_space
    starts = [each.reset(seed=6) for each in (env, copy)]
    assert_same(starts[0][0], starts[1][0])
    assert starts[0][1] == starts[1][1]
    for action in random_actions(env, 30):
        assert_same(env.step(action)[0], copy.step(action)[0])


def test_a_loaded_part_is_pickled_with_its_env() -> None:
    env = small_env(part=load_part("bracket"), render_mode="rgb_array")
    copy = pickle.loads(pickle.dumps(env))
    assert copy.render_mode == "rgb_array"
    assert copy.part.source == "bracket"
    assert_same(env.reset(seed=0)[0], copy.reset(seed=0)[0])


@pytest.mark.slow
def test_help_works_after_importing_the_package_alone() -> None:
    """In a fresh interpreter, which loads the environment's modules only when they are asked for."""
    code = (
        "import pydoc, sys, binpick_env; loaded = 'mujoco' in sys.modules; "
        "print(loaded, '## Action space' in pydoc.render_doc(binpick_env.env.BinPickEnv))"
    )
    run = subprocess.run([sys.executable, "-c", code], env=os.environ, capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False", "True"]

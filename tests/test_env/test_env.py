"""``BinPick-v0``: Gymnasium's and SB3's contracts, repeatability, frames, rewards, and what is refused."""

import inspect
import pickle
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RescaleAction
from hypothesis import given, settings
from hypothesis import strategies as st
from small_cell import CAMERA, above_tray, centred, small_env

import binpick_env  # noqa: F401  registers the id
from binpick_env import env as env_module
from binpick_env.camera import DepthCamera
from binpick_env.candidates import FEATURES, MAX_CANDIDATES
from binpick_env.config import BinConfig, CameraConfig, CellConfig
from binpick_env.env import AWAY, HOME_ZONE, MAX_EPISODE_STEPS, BinPickEnv
from binpick_env.outcomes import Delivery
from binpick_env.parts import load_part
from binpick_env.perceiver import PoseNoise
from binpick_env.robot import HOME
from binpick_env.sensor import SensorModel
from perception.geometry import rotation_from_6d

Step = tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]
SMALL: dict[str, Any] = {"num_parts": 3, "camera": CAMERA, "threads": 1}
REST = np.append(HOME, 0.0).astype(np.float32)
# SB3 tells that unnormalised actions and the candidates' 2-D array are unusual; both are meant.
NORMALISED = "We recommend you to use a symmetric and normalized Box action space"
TWO_DIMENSIONAL = "Your observation candidates has an unconventional shape"
GYM_NORMALISED = ".*For Box action spaces, we recommend using a symmetric and normalized space"


@pytest.fixture(scope="module")
def shared() -> Iterator[BinPickEnv]:
    env = small_env()
    yield env
    env.close()


@pytest.fixture
def env(shared: BinPickEnv) -> BinPickEnv:
    shared.reset(seed=0)
    return shared


def act(env: gym.Env[Any, Any], seconds: float, action: np.ndarray = REST) -> list[Step]:
    return [env.step(action) for _ in range(round(seconds * 25))]  # type: ignore[misc]


def random_actions(env: BinPickEnv, count: int, seed: int = 5) -> list[np.ndarray]:
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(count)]


def assert_same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> None:
    assert first.keys() == second.keys()
    for key in first:
        np.testing.assert_array_equal(first[key], second[key], err_msg=key)


def differ(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> bool:
    return any(np.any(first[key] != second[key]) for key in first)


# --- contracts


@pytest.mark.parametrize("obs_mode", ["state", "rgbd"])
@pytest.mark.filterwarnings(f"ignore:{GYM_NORMALISED}:UserWarning")
def test_gymnasiums_checker(obs_mode: str) -> None:
    env = small_env(obs_mode=obs_mode)
    check_env(env, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("render_mode", ["rgb_array", "depth_array"])
@pytest.mark.filterwarnings(f"ignore:{GYM_NORMALISED}:UserWarning")
def test_gymnasiums_checker_renders(render_mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # It makes every declared mode; the viewer is not to be had without a display, which test_render.py is about.
    monkeypatch.setitem(BinPickEnv.metadata, "render_modes", [render_mode])
    check_env(gym.make("BinPick-v0", render_mode=render_mode, **SMALL).unwrapped)


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


def test_it_tells_when_the_registrations_steps_are_used_up(env: BinPickEnv, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_the_docstring_tells_of_every_argument_and_observation(shared: BinPickEnv) -> None:
    text = BinPickEnv.__doc__ or ""
    assert set(re.findall(r"^    \| `(\w+)` \|", text, flags=re.MULTILINE)) >= set(
        inspect.signature(BinPickEnv).parameters
    )
    assert all(f"`{key}`" in text for key in shared._observed)


@pytest.mark.slow
def test_sb3_runs_copies_in_processes() -> None:
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv

    vector = make_vec_env(
        "binpick_env:BinPick-v0",
        n_envs=2,
        seed=4,
        env_kwargs=SMALL,
        vec_env_cls=SubprocVecEnv,
        vec_env_kwargs={"start_method": "forkserver"},
    )
    observation = vector.reset()
    assert {key: value.shape[0] for key, value in observation.items()} == dict.fromkeys(observation, 2)
    for _ in range(3):
        observation, rewards, dones, infos = vector.step(np.stack([REST, REST]))
    vector.close()
    assert rewards.tolist() == [0.0, 0.0]
    assert not dones.any()
    assert [info["total"] for info in infos] == [3, 3]
    alone = small_env()  # the workers' bits are this process's
    expected, _ = alone.reset(seed=4)
    np.testing.assert_array_equal(observation["candidates"][0], expected["candidates"])
    assert np.any(observation["candidates"][1] != expected["candidates"])


# --- repeatability


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


def test_resetting_with_the_same_seed_after_another(shared: BinPickEnv) -> None:
    first, _ = shared.reset(seed=8)
    frame = shared.frame.depth
    other, _ = shared.reset(seed=9)
    again, _ = shared.reset(seed=8)
    assert_same(first, again)
    np.testing.assert_array_equal(shared.frame.depth, frame)
    assert differ(first, other)
    following, _ = shared.reset()
    assert differ(again, following)


def test_seed_zero_is_a_seed(shared: BinPickEnv) -> None:
    assert_same(shared.reset(seed=0)[0], shared.reset(seed=0)[0])


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


# --- observations


def test_observations_by_hand(env: BinPickEnv) -> None:
    observation = act(env, 1.0)[-1][0]
    np.testing.assert_allclose(observation["joint_pos"], HOME, atol=1e-3)
    np.testing.assert_allclose(observation["joint_vel"], 0.0, atol=1e-3)
    np.testing.assert_allclose(observation["gripper"], 0.0, atol=0.01)
    np.testing.assert_allclose(observation["tcp_pose"][:3], (0.42, -0.42, 0.30), atol=1e-3)
    np.testing.assert_allclose(np.abs(observation["tcp_pose"][3:]), (0, 1, 0, 0), atol=1e-3)  # half a turn about x
    np.testing.assert_allclose(observation["frame_age"], 1.0, atol=1e-5)
    closed = act(env, 1.0, np.append(HOME, 1.0).astype(np.float32))[-1][0]
    assert closed["gripper"][0] > 0.95


def test_candidates_are_the_visible_parts(env: BinPickEnv) -> None:
    observation = env.look()
    count = int(observation["candidate_mask"].sum())
    assert count == len(env.candidates) == (env.view.visible_fractions >= 0.3).sum() > 0
    T_bin_world = np.linalg.inv(env.workspace.T_world_bin)
    poses = env.simulation.part_poses()
    for row, candidate in zip(observation["candidates"], env.candidates, strict=False):
        truth = T_bin_world @ poses[candidate.part]
        np.testing.assert_allclose(rotation_from_6d(row[3:9].astype(np.float64)), truth[:3, :3], atol=1e-5)
        centre = truth[:3, :3] @ env.part.model.centre + truth[:3, 3]
        np.testing.assert_allclose(row[:3], centre, atol=1e-6)
        assert 0.0 < row[FEATURES.index("height")] < 0.24


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**31 - 1), count=st.integers(0, 3))
def test_rows_and_mask_agree_for_every_bin(shared: BinPickEnv, seed: int, count: int) -> None:
    observation, info = shared.reset(seed=seed, options={"num_parts": count})
    mask, rows = observation["candidate_mask"], observation["candidates"]
    assert shared.observation_space.contains(observation)
    assert info["total"] == info["remaining"] == count
    assert mask.sum() <= count
    np.testing.assert_array_equal(mask, np.sort(mask)[::-1])  # rows are filled from the first on
    np.testing.assert_array_equal(np.any(rows != 0, axis=1), mask == 1)
    visible = rows[mask == 1, FEATURES.index("visible_fraction")]
    np.testing.assert_array_equal(visible, np.sort(visible)[::-1])
    assert np.all(visible >= np.float32(0.3))


def test_an_empty_bin_offers_nothing_and_is_over(shared: BinPickEnv) -> None:
    observation, info = shared.reset(seed=0, options={"num_parts": 0})
    assert not observation["candidate_mask"].any()
    assert not observation["candidates"].any()
    assert info["remaining"] == 0
    *_, terminated, truncated, _ = shared.step(REST)
    assert terminated
    assert not truncated


@pytest.mark.slow
def test_more_parts_than_rows_are_cut_at_the_rows() -> None:
    wide = replace(CellConfig(), bin=BinConfig(inner_size=(0.5, 0.5, 0.12)))
    env = small_env(num_parts=40, config=wide, camera=CameraConfig(width=320, height=320))
    observation, _ = env.reset(seed=0)
    assert (env.view.visible_fractions >= 0.3).sum() > MAX_CANDIDATES
    assert len(env.candidates) == MAX_CANDIDATES
    np.testing.assert_array_equal(observation["candidate_mask"], 1)
    assert env.observation_space.contains(observation)


def test_images_are_observed_where_wanted() -> None:
    env = small_env(obs_mode="rgbd", sensor="none")
    observation, _ = env.reset(seed=0)
    assert observation["image"].shape == observation["depth"].shape == (120, 160, 1)
    assert (observation["image"].dtype, observation["depth"].dtype) == (np.uint8, np.float32)
    np.testing.assert_array_equal(observation["image"][..., 0], env.frame.grey)
    np.testing.assert_array_equal(observation["depth"][..., 0], env.frame.depth)
    assert 0.75 < observation["depth"][60, 80, 0] < 0.95
    observation["depth"][:] = 0.0  # the user's copy
    assert env.frame.depth.any()


def test_the_state_is_all_there_is_by_default(shared: BinPickEnv) -> None:
    assert sorted(shared._observed) == [
        "candidate_mask",
        "candidates",
        "frame_age",
        "gripper",
        "joint_pos",
        "joint_vel",
        "tcp_pose",
    ]


def test_nan_in_a_depth_image_is_no_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    def blinded(model: SensorModel, depth_true: np.ndarray, *_: object) -> np.ndarray:
        depth = depth_true.copy()
        depth[::3], depth[1::3, ::2], depth[2::3, ::2] = np.nan, np.inf, -1.0
        return depth

    monkeypatch.setattr(SensorModel, "apply", blinded)
    env = small_env(obs_mode="rgbd")
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    depth = observation["depth"][..., 0]
    assert np.isfinite(depth).all()
    assert not depth[::3].any()
    assert depth[2::3, 1::2].any()
    assert observation["candidate_mask"].any()


@pytest.mark.parametrize("seed", range(2))
def test_observations_stay_in_their_space(env: BinPickEnv, seed: int) -> None:
    for action in random_actions(env, 60, seed):
        observation, reward, *_ = env.step(action)
        assert env.observation_space.contains(observation)
        assert all(np.isfinite(value).all() for value in observation.values())
        assert np.isfinite(reward)


@pytest.mark.slow
def test_two_thousand_random_actions_do_no_harm() -> None:
    env = small_env(num_parts=6)
    env.reset(seed=0)
    total = 0.0
    for action in random_actions(env, 2000):
        observation, reward, terminated, _, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert all(np.isfinite(value).all() for value in observation.values())
        assert info["remaining"] + len(env.events) == 6
        total += reward
        if terminated:
            env.reset()
    assert np.isfinite(total)


# --- frames


def away(distance: float) -> np.ndarray:
    action = REST.copy()
    action[0] += distance
    return action


def test_a_frame_is_taken_when_the_arm_comes_home(env: BinPickEnv) -> None:
    ids = [info["frame_id"] for *_, info in act(env, 0.8, away(-1.0))]
    assert set(ids) == {0}
    steps = act(env, 1.2)
    ids = [info["frame_id"] for *_, info in steps]
    assert ids == sorted(ids)
    assert (ids[0], ids[-1]) == (0, 1)
    taken = ids.index(1)
    ages = [observation["frame_age"][0] for observation, *_ in steps]
    assert ages[taken - 1] == pytest.approx(0.8 + 0.04 * taken, abs=1e-4)
    assert ages[taken] == 0.0
    distance = np.abs(steps[taken][0]["joint_pos"] - HOME).max()
    assert distance < HOME_ZONE
    assert np.abs(steps[taken - 1][0]["joint_pos"] - HOME).max() > HOME_ZONE


@pytest.mark.parametrize("distance", [HOME_ZONE + 0.05, AWAY - 0.02])
def test_a_short_excursion_takes_no_frame(env: BinPickEnv, distance: float) -> None:
    for _ in range(2):
        act(env, 0.4, away(-distance))
        info = act(env, 0.4)[-1][4]
    assert info["frame_id"] == env.frame_id == 0


def test_a_frame_follows_what_happened_in_the_bin(env: BinPickEnv) -> None:
    part = env.candidates[0].part
    act(env, 0.8, away(-1.0))
    env.simulation.place(part, centred(env.simulation, (0.8, 0.4, 0.05)))
    assert part in [c.part for c in env.candidates]  # the last frame still shows it
    act(env, 0.8)
    assert env.frame_id == 1
    assert part not in [c.part for c in env.candidates]


def test_look_takes_another_frame_with_fresh_noise(env: BinPickEnv) -> None:
    first, offered = env.capture, [c.part for c in env.candidates]
    act(env, 0.4)
    observation = env.look()
    second = env.capture
    assert first is not None
    assert second is not None
    assert env.frame_id == 1
    assert observation["frame_age"][0] == 0.0
    np.testing.assert_array_equal(first.instance_ids, second.instance_ids)
    np.testing.assert_array_equal(first.depth_true, second.depth_true)
    both = first.frame.valid & second.frame.valid
    assert np.mean(first.frame.depth[both] != second.frame.depth[both]) > 0.9
    assert [c.part for c in env.candidates] == offered
    assert env.step(REST)[4]["frame_id"] == 1


def test_a_perfect_sensor_sees_the_same_twice() -> None:
    env = small_env(sensor="none")
    env.reset(seed=0)
    before = env.frame.depth
    env.look()
    np.testing.assert_array_equal(env.frame.depth, before)


@pytest.mark.parametrize(
    ("camera", "check"),
    [
        (replace(CAMERA, width=200), lambda env: env.frame.depth.shape == (120, 200)),
        (replace(CAMERA, height=100), lambda env: env.frame.depth.shape == (100, 160)),
        (replace(CAMERA, focal=3000.0), lambda env: env.frame.K[0, 0] == pytest.approx(3000 * 160 / 1280)),
        (
            replace(CAMERA, distance=1.1),
            lambda env: env.frame.T_world_cam[2, 3] == pytest.approx(1.1 + env.config.bin.wall),
        ),
        (replace(CAMERA, backend="rays"), lambda env: env.camera._rays is not None),
    ],
)
def test_camera_settings_arrive(shared: BinPickEnv, camera: CameraConfig, check: Callable[[BinPickEnv], bool]) -> None:
    env = small_env(camera=camera, sensor="none")
    env.reset(seed=0)
    assert env.config.camera == camera
    assert check(env)
    shared.reset(seed=0)
    assert not check(shared)


# --- rewards and ends


def test_a_delivery_is_rewarded_once(env: BinPickEnv) -> None:
    env.simulation.place(0, above_tray(env.simulation))
    steps = act(env, 3.0)
    rewards = [reward for _, reward, *_ in steps]
    assert sum(rewards) == 1.0
    when = int(np.argmax(rewards))
    info = steps[when][4]
    assert (info["delivered"], info["remaining"], info["total"], info["last_event"]) == (1, 2, 3, "delivered")
    assert steps[when + 1][4]["last_event"] == ""
    assert steps[-1][4]["delivered"] == 1
    assert not any(terminated for *_, terminated, _, _ in steps)
    assert [event.kind for event in env.events] == [Delivery.DELIVERED]
    assert not env.unjudged()


def test_company_in_the_tray_earns_nothing(env: BinPickEnv) -> None:
    for i in range(2):
        env.simulation.place(i, above_tray(env.simulation, x=0.12 * i - 0.06))
    steps = act(env, 3.0)
    assert sum(reward for _, reward, *_ in steps) == 0.0
    assert steps[-1][4]["remaining"] == 1
    assert [event.kind for event in env.events] == [Delivery.DOUBLE] * 2


def test_a_lost_part_is_waited_for(env: BinPickEnv) -> None:
    env.simulation.place(0, centred(env.simulation, (0.8, 0.4, 0.05)))
    act(env, 0.4)
    assert env.unjudged()
    assert sum(reward for _, reward, *_ in act(env, 3.0)) == 0.0
    assert [event.kind for event in env.events] == [Delivery.LEFT_BIN]
    assert not env.unjudged()


@pytest.mark.parametrize(("place", "success"), [("tray", True), ("table", False)])
def test_an_episode_ends_when_nothing_is_left(env: BinPickEnv, place: str, success: bool) -> None:
    env.reset(seed=0, options={"num_parts": 1})
    pose = above_tray(env.simulation) if place == "tray" else centred(env.simulation, (0.8, 0.4, 0.05))
    env.simulation.place(0, pose)
    for _ in range(100):
        *_, terminated, truncated, info = env.step(REST)
        assert info["success"] is info["is_success"] is (terminated and success)
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["remaining"] == env.remaining == 0


def test_a_new_episode_forgets_the_last(env: BinPickEnv) -> None:
    env.simulation.place(0, above_tray(env.simulation))
    act(env, 2.0)
    assert env.delivered == 1
    _, info = env.reset(seed=1)
    assert (info["delivered"], info["remaining"], info["frame_id"]) == (0, 3, 0)
    assert env.events == []
    assert env.simulation.time == 0.0


@pytest.mark.parametrize(("num_parts", "wanted"), [(2, {2}), ((1, 3), {1, 2, 3}), ([2, 2], {2})])
def test_the_number_of_parts_is_drawn_from_its_range(
    num_parts: Any, wanted: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(env_module, "drop_and_settle", lambda *_: None)
    env = small_env(num_parts=num_parts)
    assert {env.reset(seed=seed)[1]["total"] for seed in range(20)} == wanted


# --- pictures


def test_render_modes_return_arrays() -> None:
    env = small_env(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture is not None
    assert (picture.shape, picture.dtype) == ((480, 640, 3), np.uint8)
    assert picture.std() > 10
    env.close()
    env.close()  # does no harm
    env = small_env(render_mode="depth_array")
    env.reset(seed=0)
    depth = env.render()
    assert depth is not None
    assert (depth.shape, depth.dtype) == ((120, 160), np.float32)
    capture = env.capture
    assert capture is not None
    np.testing.assert_array_equal(depth, capture.depth_true)
    env.close()


def test_rendering_changes_nothing() -> None:
    watched, alone = small_env(render_mode="depth_array"), small_env()
    for env in (watched, alone):
        env.reset(seed=0)
    watched.render()
    assert_same(watched.look(), alone.look())


def test_without_a_mode_there_is_no_picture(env: BinPickEnv) -> None:
    assert env.render() is None


def test_human_mode_without_a_display_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = small_env(render_mode="human")
    env.reset(seed=0)
    with pytest.raises(RuntimeError, match="render_mode='human' needs a display, and none is set; 'rgb_array' needs"):
        env.step(REST)


def test_human_mode_refreshes_the_viewer(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[int] = []
    env = small_env(render_mode="human")
    monkeypatch.setattr(env._renderer, "show", lambda: shown.append(1))
    env.reset(seed=0)
    act(env, 0.12)
    assert len(shown) >= 3


# --- faults


@pytest.mark.parametrize("num_parts", [0, -1, (0, 5), (5, 4)])
def test_a_senseless_number_of_parts_is_refused(num_parts: Any) -> None:
    text = f"num_parts must be a positive number or a rising pair, got {re.escape(str(num_parts))}"
    with pytest.raises(ValueError, match=text):
        small_env(num_parts=num_parts)


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("perception", "lidar", "perception must be one of oracle, gt_masks, learned, got 'lidar'"),
        ("render_mode", "ansi", r"render_mode must be one of \['human', 'rgb_array', 'depth_array'\], got 'ansi'"),
        ("obs_mode", "pixels", "obs_mode must be 'state' or 'rgbd', got 'pixels'"),
        ("part", "sprocket", "part must be one of part_a, part_b, part_c, tee, bracket"),
    ],
)
def test_an_unknown_choice_names_those_that_exist(argument: str, value: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small_env(**{argument: value})


@pytest.mark.parametrize(("mode", "lacks"), [("gt_masks", "pose estimator"), ("learned", "segmentation network")])
def test_a_mode_that_is_not_built_says_what_is_missing(mode: str, lacks: str) -> None:
    with pytest.raises(NotImplementedError, match=f"perception='{mode}' needs .*{lacks}.*use perception='oracle'"):
        small_env(perception=mode)


def test_an_unknown_sensor_is_refused() -> None:
    with pytest.raises(ValueError, match="sensor must be one of none, good, harsh or a SensorModel, got 'nice'"):
        small_env(sensor="nice").reset(seed=0)


@pytest.mark.parametrize("action", [np.zeros(6), np.zeros((1, 7)), np.full(7, np.nan), [0, 0, 0, 0, 0, 0, np.inf], 0.0])
def test_a_senseless_action_is_refused(env: BinPickEnv, action: Any) -> None:
    before = env.simulation.time
    with pytest.raises(ValueError, match=r"action must be \(7,\) and finite, got"):
        env.step(action)
    assert env.simulation.time == before


def test_an_action_out_of_range_is_held_to_it(env: BinPickEnv) -> None:
    act(env, 4.0, np.append(HOME + np.array([0, 0, 0, 0, 0, 50.0]), 9.0).astype(np.float32))
    assert env.simulation.target[5] == pytest.approx(2 * np.pi, abs=1e-3)
    assert env.simulation.gripper_target == 1.0


def test_more_parts_than_there_is_room_for_are_refused(shared: BinPickEnv) -> None:
    with pytest.raises(ValueError, match=r"count must be in 0\.\.3, got 4"):
        shared.reset(seed=0, options={"num_parts": 4})


def test_there_is_no_frame_before_the_first_reset() -> None:
    env = small_env()
    with pytest.raises(RuntimeError, match=r"there is no frame before the first reset\(\)"):
        _ = env.frame


def test_a_diverged_cell_is_an_error(shared: BinPickEnv) -> None:
    shared.reset(seed=0)
    shared.simulation.data.qvel[0] = np.nan
    with pytest.raises(FloatingPointError, match="the physics diverged"):
        shared.step(REST)
    observation, _ = shared.reset(seed=0)
    assert shared.observation_space.contains(observation)


def test_a_mesh_file_is_a_part_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "block.stl"
    trimesh.creation.box((0.07, 0.04, 0.03)).export(path)
    env = small_env(part=str(path))
    observation, _ = env.reset(seed=0)
    assert observation["candidate_mask"].any()


def test_nothing_warns() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make("BinPick-v0", **SMALL)
        env.reset(seed=0)
        env.step(REST)
        env.close()


def test_the_camera_sees_the_simulation_of_the_env(env: BinPickEnv) -> None:
    """Oracle: a camera of one's own on the same data delivers the same truth."""
    camera = DepthCamera(env.simulation.model, CAMERA, env.workspace, env.simulation.part_of_geom)
    capture = env.capture
    assert capture is not None
    own = camera.capture(env.simulation.data, np.random.default_rng(0), "none")
    np.testing.assert_array_equal(own.depth_true, capture.depth_true)
    np.testing.assert_array_equal(own.instance_ids, capture.instance_ids)

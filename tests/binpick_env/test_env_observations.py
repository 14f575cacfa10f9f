"""What ``BinPick-v0`` observes, and when it takes a frame."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from binpick_env.camera.depth_camera import DepthCamera
from binpick_env.camera.sensor import SensorModel
from binpick_env.candidates import FEATURES, MAX_CANDIDATES
from binpick_env.cell.robot import HOME
from binpick_env.config import BinConfig, CameraConfig, CellConfig
from binpick_env.env import BinPickEnv
from binpick_env.episode import AWAY, HOME_ZONE
from perception.geometry import rotation_from_6d
from tests.binpick_env.small_cell import CAMERA, REST, act, centred, random_actions, small_env

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
    assert count == len(env.candidates) == (env.labelled_capture.visible_fractions >= 0.3).sum() > 0
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
def test_rows_and_mask_agree_for_every_bin(shared_env: BinPickEnv, seed: int, count: int) -> None:
    observation, info = shared_env.reset(seed=seed, options={"num_parts": count})
    mask, rows = observation["candidate_mask"], observation["candidates"]
    assert shared_env.observation_space.contains(observation)
    assert info["total"] == info["remaining"] == count
    assert mask.sum() <= count
    np.testing.assert_array_equal(mask, np.sort(mask)[::-1])  # rows are filled from the first on
    np.testing.assert_array_equal(np.any(rows != 0, axis=1), mask == 1)
    visible = rows[mask == 1, FEATURES.index("visible_fraction")]
    np.testing.assert_array_equal(visible, np.sort(visible)[::-1])
    assert np.all(visible >= np.float32(0.3))


def test_an_empty_bin_offers_nothing_and_is_over(shared_env: BinPickEnv) -> None:
    observation, info = shared_env.reset(seed=0, options={"num_parts": 0})
    assert not observation["candidate_mask"].any()
    assert not observation["candidates"].any()
    assert info["remaining"] == 0
    *_, terminated, truncated, _ = shared_env.step(REST)
    assert terminated
    assert not truncated


@pytest.mark.slow
def test_more_parts_than_rows_are_cut_at_the_rows() -> None:
    wide = replace(CellConfig(), bin=BinConfig(inner_size=(0.5, 0.5, 0.12)))
    env = small_env(num_parts=40, config=wide, camera=CameraConfig(width=320, height=320))
    observation, _ = env.reset(seed=0)
    assert (env.labelled_capture.visible_fractions >= 0.3).sum() > MAX_CANDIDATES
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


def test_the_state_is_all_there_is_by_default(shared_env: BinPickEnv) -> None:
    assert sorted(shared_env._boxes) == [
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
def test_five_hundred_random_actions_do_no_harm() -> None:
    env = small_env(num_parts=6)
    env.reset(seed=0)
    total = 0.0
    for action in random_actions(env, 500):
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


def test_a_frame_taken_ahead_stands_for_the_next_one_at_home(env: BinPickEnv) -> None:
    act(env, 0.8, away(-1.0))
    taken = env.simulation.time
    env.look(ahead=True)
    observation, *_, info = act(env, 1.2)[-1]
    assert (info["frame_id"], env.episode.frame.time) == (1, taken)
    assert observation["frame_age"][0] == pytest.approx(1.2, abs=1e-4)
    act(env, 0.8, away(-1.0))
    assert act(env, 1.2)[-1][4]["frame_id"] == 2  # the one after is taken at home again


def test_a_frame_taken_ahead_at_home_stands_for_no_other(env: BinPickEnv) -> None:
    env.look(ahead=True)
    act(env, 0.8, away(-1.0))
    assert act(env, 1.2)[-1][4]["frame_id"] == 2


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
def test_camera_settings_arrive(
    shared_env: BinPickEnv, camera: CameraConfig, check: Callable[[BinPickEnv], bool]
) -> None:
    env = small_env(camera=camera, sensor="none")
    env.reset(seed=0)
    assert env.config.camera == camera
    assert check(env)
    shared_env.reset(seed=0)
    assert not check(shared_env)


def test_the_camera_sees_the_simulation_of_the_env(env: BinPickEnv) -> None:
    """Oracle: a camera of one's own on the same data delivers the same truth."""
    camera = DepthCamera(env.simulation.model, CAMERA, env.workspace, env.simulation.part_of_geom)
    capture = env.capture
    assert capture is not None
    own = camera.capture(env.simulation.data, np.random.default_rng(0), "none")
    np.testing.assert_array_equal(own.depth_true, capture.depth_true)
    np.testing.assert_array_equal(own.instance_ids, capture.instance_ids)

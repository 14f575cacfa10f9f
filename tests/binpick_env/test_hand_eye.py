"""A camera that is not quite where it is believed to be."""

from dataclasses import replace

import numpy as np
import pytest

from binpick_env.camera.depth_camera import default_pose
from binpick_env.config import CameraConfig
from binpick_env.env import BinPickEnv
from tests.binpick_env.small_cell import CAMERA, small_env


def wrong_env(hand_eye: float = 0.004, **arguments: object) -> BinPickEnv:
    camera = CameraConfig(width=CAMERA.width, height=CAMERA.height, hand_eye=hand_eye)
    return small_env(camera=camera, **arguments)


def offset(env: BinPickEnv) -> np.ndarray:
    """Return how far from its true place the camera of the last frame is believed to be [m]."""
    reported, true = env.frame.T_world_cam, default_pose(env.workspace, CAMERA.distance)
    np.testing.assert_array_equal(reported[:3, :3], true[:3, :3])
    return reported[:3, 3] - true[:3, 3]


def test_the_pixels_are_those_of_the_true_place() -> None:
    env = wrong_env()
    env.reset(seed=3)
    before = env.capture
    env.camera.displace(np.zeros(3))
    after = env.camera.capture(env.simulation.data, np.random.default_rng(0))
    np.testing.assert_array_equal(before.depth_true, after.depth_true)
    np.testing.assert_array_equal(before.T_world_cam, after.T_world_cam)
    np.testing.assert_array_equal(after.T_world_cam, after.frame.T_world_cam)
    assert np.abs(offset(env)).max() > 1e-4


def test_what_is_true_of_the_parts_stays_true() -> None:
    env = small_env()
    env.reset(seed=3)
    fractions = env.labelled_capture.visible_fractions
    assert fractions.max() > 0.5
    env._episode = replace(
        env.episode, hand_eye=np.array([0.0, 0.0, -0.1])
    )  # from there parts would look larger, and seem half hidden
    env.look()
    np.testing.assert_array_equal(env.labelled_capture.visible_fractions, fractions)


def test_each_bin_has_its_own_error_and_keeps_it() -> None:
    env = wrong_env()
    env.reset(seed=3)
    first = offset(env)
    env.look()
    np.testing.assert_array_equal(offset(env), first)
    kept = env.snapshot()
    env.reset(seed=4)
    assert not np.array_equal(offset(env), first)
    env.restore(kept)
    env.look()
    np.testing.assert_array_equal(offset(env), first)
    env.reset(seed=3)
    np.testing.assert_array_equal(offset(env), first)


@pytest.mark.slow
def test_errors_are_as_large_as_said() -> None:
    env = wrong_env(0.004, num_parts=1)
    found = []
    for seed in range(40):
        env.reset(seed=seed)
        found.append(offset(env))
    assert 0.003 < np.std(found) < 0.005
    assert abs(np.mean(found)) < 0.0015


def test_without_an_error_nothing_is_drawn() -> None:
    plain, wrong = small_env(), wrong_env(0.0)
    plain.reset(seed=3)
    wrong.reset(seed=3)
    np.testing.assert_array_equal(offset(wrong), 0.0)
    np.testing.assert_array_equal(plain.frame.depth, wrong.frame.depth)
    assert plain.np_random.bit_generator.state == wrong.np_random.bit_generator.state


@pytest.mark.parametrize("hand_eye", [-0.001, 0.016, float("nan")])
def test_nonsense_is_refused(hand_eye: float) -> None:
    with pytest.raises(ValueError, match=r"hand_eye must be from 0 to 0\.015 m, got"):
        CameraConfig(hand_eye=hand_eye)


def test_the_oracle_is_as_far_off() -> None:
    env = wrong_env(0.015, sensor="none")
    env.reset(seed=3)
    assert env.candidates
    for candidate in env.candidates:
        true = env.labelled_capture.T_world_parts[candidate.part]
        np.testing.assert_allclose(candidate.T_world_part[:3, :3], true[:3, :3], atol=1e-12)
        np.testing.assert_allclose(candidate.T_world_part[:3, 3] - true[:3, 3], offset(env), atol=1e-12)

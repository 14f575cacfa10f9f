"""A camera that is not quite where it is believed to be."""

from dataclasses import replace

import numpy as np
import pytest

from binpick_env.camera.correction import correct_by_bin
from binpick_env.camera.depth_camera import default_pose
from binpick_env.config import CalibrationConfig, CameraConfig, CellConfig
from binpick_env.env import BinPickEnv
from perception.geometry import invert_transform, rotation_angle
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
    with pytest.raises(ValueError, match=r"hand_eye must be (from 0 to 0\.015 m|finite), got"):
        CameraConfig(hand_eye=hand_eye)


def test_the_oracle_is_as_far_off() -> None:
    env = wrong_env(0.015, sensor="none")
    env.reset(seed=3)
    assert env.candidates
    for candidate in env.candidates:
        true = env.labelled_capture.T_world_parts[candidate.part]
        np.testing.assert_allclose(candidate.T_world_part[:3, :3], true[:3, :3], atol=1e-12)
        np.testing.assert_allclose(candidate.T_world_part[:3, 3] - true[:3, 3], offset(env), atol=1e-12)


def seeing_env(**calibration: object) -> BinPickEnv:
    """Return a cell whose camera has pixels enough to measure the bin."""
    camera = CameraConfig(width=480, height=360, hand_eye=0.01)
    return small_env(config=CellConfig(camera=camera, calibration=CalibrationConfig(**calibration)), camera=None)


def test_a_trusted_bin_corrects_the_reported_pose() -> None:
    env = seeing_env(rotation=np.deg2rad(1.0), trust="bin")
    env.reset(seed=3)
    reported, true, corrected = env.camera.reported_pose(), env.capture.T_world_cam, env.frame.T_world_cam
    assert np.linalg.norm(reported[:3, 3] - true[:3, 3]) > 0.005
    assert rotation_angle(reported[:3, :3].T @ true[:3, :3]) > np.deg2rad(0.3)
    assert np.linalg.norm(corrected[:3, 3] - true[:3, 3]) < 0.003
    assert rotation_angle(corrected[:3, :3].T @ true[:3, :3]) < np.deg2rad(0.2)
    labelled = env.labelled_capture
    np.testing.assert_allclose(labelled.T_reported_parts[:, :3, 3], labelled.T_world_parts[:, :3, 3], atol=0.002)


def test_a_wrong_orientation_is_that_of_every_frame_of_a_bin() -> None:
    env = seeing_env(rotation=np.deg2rad(1.0))
    env.reset(seed=3)
    first = env.frame.T_world_cam
    np.testing.assert_array_equal(first, env.camera.reported_pose())
    env.look()
    np.testing.assert_array_equal(env.frame.T_world_cam, first)
    labelled = env.labelled_capture
    as_seen = first @ invert_transform(env.capture.T_world_cam) @ labelled.T_world_parts
    np.testing.assert_allclose(labelled.T_reported_parts, as_seen, atol=1e-12)
    env.reset(seed=4)
    assert not np.array_equal(env.frame.T_world_cam[:3, :3], first[:3, :3])


def test_a_bin_out_of_view_corrects_nothing() -> None:
    env = wrong_env()
    env.reset(seed=3)
    dark = replace(env.frame, depth=np.zeros_like(env.frame.depth))
    capture = correct_by_bin(replace(env.capture, frame=dark), env.workspace)
    np.testing.assert_array_equal(capture.frame.T_world_cam, env.frame.T_world_cam)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"rotation": -0.1}, r"rotation must be from 0 to 0\.06 rad, got -0\.1"),
        ({"rotation": 0.1}, r"rotation must be from 0 to 0\.06 rad, got 0\.1"),
        ({"trust": "floor"}, "trust must be one of camera, bin, got 'floor'"),
    ],
)
def test_a_calibration_without_sense_is_refused(values: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        CalibrationConfig(**values)

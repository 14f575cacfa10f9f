"""What ``BinPick-v0`` refuses or holds to its range, and what it says then."""

import re
from typing import Any

import numpy as np
import pytest

from binpick_env.cell.robot import HOME
from binpick_env.env import BinPickEnv
from binpick_env.env_arguments import thread_count
from perception.runtime.threads import use_threads
from tests.binpick_env.small_cell import REST, act, small_env


@pytest.mark.parametrize("num_parts", [0, -1, (0, 5), (5, 4), 2.5, "3", (2, 3.5), (1, 2, 3), True])
def test_a_senseless_number_of_parts_is_refused(num_parts: Any) -> None:
    text = f"num_parts must be a positive whole number or a rising pair of them, got {re.escape(repr(num_parts))}"
    with pytest.raises(ValueError, match=text):
        small_env(num_parts=num_parts)


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("perception", "lidar", "perception must be one of oracle, gt_masks, learned, got 'lidar'"),
        ("render_mode", "ansi", r"render_mode must be one of \['human', 'rgb_array', 'depth_array'\], got 'ansi'"),
        ("obs_mode", "pixels", "obs_mode must be 'state' or 'rgbd', got 'pixels'"),
        ("threads", 0, "threads must be a whole number of at least 1, got 0"),
        ("threads", 1.5, "threads must be a whole number of at least 1, got 1.5"),
        ("part", "sprocket", "part must be one of part_a, part_b, part_c, tee, bracket"),
        ("part", None, "part must be a name, a path to a file or a loaded Part, got None"),
        ("pose_noise", 3, "pose_noise must be a PoseNoise, a PerceptionNoise or 'learned', got 3"),
        ("density", "light", r"density must be 10 to 25000 kg/m\^3 .* got 'light'"),
        ("symmetry_tolerance", "small", "symmetry_tolerance must be over 0 and under 0.1 m, got 'small'"),
    ],
)
def test_an_unknown_choice_names_those_that_exist(argument: str, value: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small_env(**{argument: value})


def test_an_unknown_sensor_is_refused() -> None:
    with pytest.raises(ValueError, match="none, good, harsh, stereo, tof or a DepthSensor, got 'nice'"):
        small_env(sensor="nice")


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


def test_more_parts_than_there_is_room_for_are_refused(shared_env: BinPickEnv) -> None:
    with pytest.raises(ValueError, match=r"num_parts of reset must be a whole number from 0 to 3, .* got 4"):
        shared_env.reset(seed=0, options={"num_parts": 4})


@pytest.mark.parametrize("value", [-1, 2.5, "2", None, True])
def test_a_senseless_number_of_parts_of_a_reset_is_refused(shared_env: BinPickEnv, value: Any) -> None:
    with pytest.raises(ValueError, match=f"num_parts of reset must be a whole number from 0 to 3, .* got {value!r}"):
        shared_env.reset(seed=0, options={"num_parts": value})


def test_an_unknown_option_of_a_reset_is_refused(shared_env: BinPickEnv) -> None:
    with pytest.raises(ValueError, match="options of reset must be among num_parts, got parts"):
        shared_env.reset(seed=0, options={"parts": 2})
    with pytest.raises(ValueError, match=r"options of reset must be a dictionary, got \[2\]"):
        shared_env.reset(seed=0, options=[2])  # type: ignore[arg-type]


def test_more_parts_than_can_be_heaped_on_the_bin_are_refused_at_once() -> None:
    text = (
        r"200 parts of d_max 92 mm do not fit into a bin of 360 x 260 x 120 mm: it is full with \d+, and no more than "
        r"\d+ can be heaped on it; use fewer parts or a larger bin"
    )
    with pytest.raises(ValueError, match=text):
        small_env(num_parts=200)


def test_there_is_no_frame_before_the_first_reset() -> None:
    env = small_env()
    with pytest.raises(RuntimeError, match=r"there is no frame before the first reset\(\)"):
        _ = env.frame
    with pytest.raises(RuntimeError, match=r"there is no frame before the first reset\(\)"):
        env.step(REST)
    with pytest.raises(RuntimeError, match=r"there is no frame before the first reset\(\)"):
        env.look()


def test_the_number_of_parts_may_be_numpys() -> None:
    env = small_env(num_parts=np.int64(2))
    _, info = env.reset(seed=0)
    assert info["total"] == 2


@pytest.mark.parametrize(("around", "given", "threads"), [(None, None, 1), (4, None, 4), (4, 2, 2), (None, 3, 3)])
def test_a_cell_takes_one_thread_unless_told_otherwise(around: int | None, given: int | None, threads: int) -> None:
    with use_threads(around):
        assert thread_count(given) == threads


def test_a_diverged_cell_is_an_error(shared_env: BinPickEnv) -> None:
    shared_env.reset(seed=0)
    shared_env.simulation.data.qvel[0] = np.nan
    with pytest.raises(FloatingPointError, match="the physics diverged"):
        shared_env.step(REST)
    observation, _ = shared_env.reset(seed=0)
    assert shared_env.observation_space.contains(observation)

"""What ``BinPick-v0`` observes and how it is commanded: spaces and observations."""

from typing import Any, Literal

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from binpick_env.candidates import FEATURES, MAX_CANDIDATES
from binpick_env.cell.simulation import Simulation
from binpick_env.config import CameraConfig
from binpick_env.episode import FrameState
from perception.geometry import Floats, quat_from_matrix

Observation = dict[str, NDArray[Any]]
ObsMode = Literal["state", "rgbd"]


def observation_boxes(obs_mode: ObsMode, camera: CameraConfig) -> dict[str, spaces.Box]:
    """Return the box of each key of an observation.

    Args:
        obs_mode: ``"rgbd"`` adds the frame's image and depth.
        camera: Settings of the camera, which has the size of these images.
    """
    boxes = {
        "joint_pos": _box(-7.0, 7.0, 6),
        "joint_vel": _box(-20.0, 20.0, 6),
        "gripper": _box(0.0, 1.0, 1),
        "tcp_pose": _box(-3.0, 3.0, 7),
        "frame_age": _box(0.0, 1e6, 1),
        "candidates": _box(-10.0, 10.0, MAX_CANDIDATES, len(FEATURES)),
        "candidate_mask": _box(0, 1, MAX_CANDIDATES, dtype=np.int8),
    }
    if obs_mode == "rgbd":
        boxes["image"] = _box(0, 255, camera.height, camera.width, 1, dtype=np.uint8)
        boxes["depth"] = _box(0.0, 10.0, camera.height, camera.width, 1)
    return boxes


def observe(simulation: Simulation, frame: FrameState, boxes: dict[str, spaces.Box]) -> Observation:
    """Return the observation, held to its boxes and in their data types; no array of it is shared.

    Args:
        simulation: Physics, for the state of the robot and the time.
        frame: Last frame and its candidates.
        boxes: Box of each key that is wanted.
    """
    T_world_tcp = simulation.T_world_tcp
    values: Observation = {
        "joint_pos": simulation.joint_positions,
        "joint_vel": simulation.joint_velocities,
        "gripper": np.array([simulation.gripper_position]),
        "tcp_pose": np.concatenate([T_world_tcp[:3, 3], quat_from_matrix(T_world_tcp[:3, :3])]),
        "frame_age": np.array([simulation.time - frame.time]),
        "candidates": frame.features,
        "candidate_mask": frame.mask,
        "image": frame.labelled_capture.capture.frame.grey[..., None],
        "depth": frame.labelled_capture.capture.frame.depth[..., None],
    }
    return {k: np.clip(values[k], box.low, box.high).astype(box.dtype) for k, box in boxes.items()}


def action_limits(model: mujoco.MjModel) -> tuple[Floats, Floats]:
    """Return the lowest and the highest action, (7,) each: six joint positions [rad], gripper 0 open to 1 closed."""
    joints = model.actuator_ctrlrange[:6]
    return np.append(joints[:, 0], 0.0), np.append(joints[:, 1], 1.0)


def _box(low: float, high: float, *shape: int, dtype: type = np.float32) -> spaces.Box:
    return spaces.Box(low, high, shape=shape, dtype=dtype)

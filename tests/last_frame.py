"""Change the last frame of an environment by hand, for what happens when it shows something else."""

from dataclasses import replace
from typing import Any

import numpy as np

from binpick_env.camera.depth_camera import Capture
from binpick_env.env import BinPickEnv


def change_frame(env: BinPickEnv, **changes: Any) -> None:
    """Replace fields of the environment's `FrameState`."""
    env._episode = replace(env.episode, frame=replace(env.episode.frame, **changes))


def change_capture(env: BinPickEnv, capture: Capture) -> None:
    """Replace the capture behind the last frame; the ground truth of the parts stays."""
    change_frame(env, labelled_capture=replace(env.labelled_capture, capture=capture))


def change_depth(env: BinPickEnv, depth: Any) -> None:
    """Replace the last frame's depth by (H, W) values, or by one number [m]."""
    frame = env.frame
    full = np.broadcast_to(np.asarray(depth, np.float32), frame.depth.shape)
    change_capture(env, replace(env.capture, frame=replace(frame, depth=full)))

"""Perception without the simulator: a camera's arrays in a file, poses out."""

import tempfile
from pathlib import Path

import gymnasium as gym
import numpy as np

import binpick_env  # noqa: F401 - registers the environments
from binpick_env.parts import load_part
from perception import Frame, Pipeline, PoseEstimate, Workspace


def record(path: Path) -> None:
    """Stand in for your camera: write one simulated frame as plain arrays."""
    env = gym.make("BinPick-v0", part="tee", num_parts=6, perception="oracle").unwrapped
    env.reset(seed=3)
    frame, workspace = env.frame, env.workspace
    arrays = {"grey": frame.grey, "depth": frame.depth, "K": frame.K, "T_world_cam": frame.T_world_cam}
    np.savez(path, T_world_bin=workspace.T_world_bin, inner_size=workspace.inner_size, **arrays)
    env.close()


def main(path: Path) -> list[PoseEstimate]:
    """Return the poses in a file of arrays."""
    arrays = np.load(path)
    frame = Frame(**{name: arrays[name] for name in ("grey", "depth", "K", "T_world_cam")})
    workspace = Workspace(T_world_bin=arrays["T_world_bin"], inner_size=arrays["inner_size"])
    seen = Pipeline.for_part(load_part("tee").model, workspace).perceive(frame)
    for pose in seen.poses:
        print(f"score {pose.score:.2f} at {np.round(frame.T_world_cam @ pose.T_cam_part, 3)[:3, 3]} m in the world")
    return seen.poses


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        record(Path(made) / "frame.npz")
        main(Path(made) / "frame.npz")

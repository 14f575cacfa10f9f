"""A frame of the simulated depth camera, and the boundary points in it."""

import tempfile
from pathlib import Path

import cv2
import gymnasium as gym
import numpy as np

import binpick_env  # noqa: F401 - registers the environments
from perception.boundary import BoundaryCloud, extract_boundary


def main(folder: Path, num_parts: int = 8) -> BoundaryCloud:
    """Write grey.png and boundary.png, and return the boundary points."""
    env = gym.make("BinPick-v0", part="bracket", num_parts=num_parts, perception="oracle").unwrapped
    env.reset(seed=1)
    frame = env.frame
    boundary = extract_boundary(frame, env.workspace)
    print(f"{frame.grey.shape[1]} x {frame.grey.shape[0]} pixels, {np.mean(frame.depth > 0):.0%} with depth")
    print(f"{len(boundary)} boundary points, {1000 * np.ptp(boundary.points_cam[:, 2]):.0f} mm from front to back")
    cv2.imwrite(str(folder / "grey.png"), frame.grey)
    picture = cv2.cvtColor(frame.grey, cv2.COLOR_GRAY2BGR)
    picture[boundary.pixels[:, 1], boundary.pixels[:, 0]] = (0, 128, 255)
    cv2.imwrite(str(folder / "boundary.png"), picture)
    env.close()
    return boundary


if __name__ == "__main__":
    kept = Path(tempfile.mkdtemp())
    main(kept)
    print("pictures in", kept)

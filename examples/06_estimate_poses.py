"""PPF-MEAM estimates the pose of each true segment; the errors are printed modulo the part's symmetry."""

import gymnasium as gym
import numpy as np

import binpick_env  # noqa: F401 - registers the environments
from perception.boundary import extract_boundary
from perception.instance import true_instances
from perception.metrics.pose_errors import pose_error
from perception.pose.estimator import PoseEstimator


def main(num_parts: int = 6) -> list[float]:
    """Return the distance of each returned pose from the nearest true one [m]."""
    env = gym.make("BinPick-v0", part="bracket", num_parts=num_parts, perception="oracle").unwrapped
    env.reset(seed=3)
    capture, part = env.labelled_capture, env.part.model
    frame = capture.capture.frame
    boundary = extract_boundary(frame, env.workspace)
    part_ids = capture.capture.instance_ids[boundary.pixels[:, 1], boundary.pixels[:, 0]].astype("int64")
    estimator = PoseEstimator(part, workspace=env.workspace)  # builds the part's models; seconds the first time
    errors = []
    for pose in estimator.estimate(boundary, true_instances(part_ids, min_points=90), frame):
        T_world_part = frame.T_world_cam @ pose.T_cam_part
        candidates = [pose_error(T_world_part, T_true, part) for T_true in capture.T_world_parts]
        best = min(candidates, key=lambda error: error.translation)
        errors.append(best.translation)
        print(f"score {pose.score:.2f}: {1e3 * best.translation:.2f} mm, {np.degrees(best.rotation):.2f} deg")
    env.close()
    return errors


if __name__ == "__main__":
    main()

"""Poses between two poses."""

import numpy as np

from perception.geometry import make_transform, rotation_about
from policies.motion.targets import interpolate_poses


def test_between_poses_that_differ_by_rounding_nothing_turns() -> None:
    R = rotation_about((0.3, -0.5, 0.8), 2.1)
    turned = R @ np.array([[1.0, 3e-12, 0.0], [-3e-12, 1.0, 0.0], [0.0, 0.0, 1.0]])
    poses = list(interpolate_poses(make_transform(R), make_transform(turned, (0.0, 0.0, 0.01)), 0.005))
    assert len(poses) == 2
    np.testing.assert_allclose([pose[:3, :3] for pose in poses], [R, R], atol=1e-9)
    np.testing.assert_allclose([pose[2, 3] for pose in poses], [0.005, 0.01])

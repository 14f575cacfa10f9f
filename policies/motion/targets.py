"""Target poses and postures of the arm: checked, compared and interpolated."""

from collections.abc import Iterator, Sequence

import mink
import numpy as np

from perception.geometry import Floats, make_transform, require_shape, rotation_about, rotation_angle
from policies.motion.planning_scene import DOF


def turn_about_base(T_world_from: Floats, T_world_to: Floats) -> float:
    """Return the angle about the world's z [rad], in [-pi, pi], between the directions of two poses from the base."""
    (x, y), (to_x, to_y) = T_world_from[:2, 3], T_world_to[:2, 3]
    return float(np.arctan2(x * to_y - y * to_x, x * to_x + y * to_y))


def pose_residual(T_world_tcp: Floats, T_world_target: Floats) -> tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses."""
    rotation = T_world_tcp[:3, :3].T @ T_world_target[:3, :3]
    return float(np.linalg.norm(T_world_tcp[:3, 3] - T_world_target[:3, 3])), float(rotation_angle(rotation))


def interpolate_poses(T_a: Floats, T_b: Floats, spacing: float) -> Iterator[Floats]:
    """Yield (4, 4) poses on the line from ``T_a``, excluded, to ``T_b``, at most ``spacing`` [m] and 0.05 rad apart."""
    distance, angle = pose_residual(T_a, T_b)
    steps = int(np.ceil(max(distance / spacing, angle / 0.05)))
    turn = T_a[:3, :3].T @ T_b[:3, :3]
    axis = mink.SO3.from_matrix(turn).log()
    if not axis.any():  # it is zero up to angles that rounding gives two equal rotations
        angle = 0.0
    for k in range(1, steps + 1):
        share = k / steps
        partial = rotation_about(axis, share * angle) if angle > 1e-12 else np.eye(3)
        yield make_transform(T_a[:3, :3] @ partial, (1 - share) * T_a[:3, 3] + share * T_b[:3, 3])


def checked_pose(T_world_tcp: Floats) -> mink.SE3:
    """Return a (4, 4) target as mink's type, or raise ``ValueError`` if it is not a finite rigid transform."""
    T = np.asarray(T_world_tcp, dtype=np.float64)
    require_shape("T_world_tcp", T, (4, 4))
    if not np.all(np.isfinite(T)):
        raise ValueError("T_world_tcp must be finite")
    if not np.allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-6) or np.linalg.det(T[:3, :3]) < 0:
        raise ValueError("T_world_tcp must hold a rotation, got a matrix that is not orthonormal and right-handed")
    return mink.SE3.from_matrix(T)


def checked_postures(name: str, postures: Floats | Sequence[Floats]) -> Floats:
    """Return one posture, (6,), or several, (K, 6), as finite (K, 6)."""
    checked: Floats = np.atleast_2d(np.asarray(postures, dtype=np.float64))
    require_shape(name, checked, (None, DOF))
    if len(checked) == 0 or not np.all(np.isfinite(checked)):
        raise ValueError(f"{name} must be finite and hold at least one posture")
    return checked

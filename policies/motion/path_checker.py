"""Collision checks of joint paths: the robot against cell and itself, points on the tool against the pile."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from perception.geometry import Floats, require_shape
from policies.motion._kernels import place_points
from policies.motion.planning_scene import DOF, PlanningScene

HeightFunction = Callable[[Floats], Floats]  # maps (P, 3) world points to the (P,) height of the pile under each [m]
_TIP_STEP, _JOINT_STEP = 0.02, 0.1  # largest motion of tcp and joints between checked samples [m], [rad]


@dataclass(frozen=True, eq=False, kw_only=True)
class PathCheck:
    """Result of a collision check.

    Attributes:
        q_hit: (6,) first posture in collision [rad]; None if the path is free.
        reason: Names of the two bodies that touch, and their distance.
    """

    q_hit: Floats | None = None
    reason: str = ""

    @property
    def free(self) -> bool:
        """Whether no sample is in collision."""
        return self.q_hit is None


class PathChecker:
    """Checks dense samples of a path. Holds nothing but the scene."""

    def __init__(self, scene: PlanningScene) -> None:
        """Keep the scene, which computes kinematics and contacts."""
        self._scene = scene

    def check(
        self,
        q: Floats,
        *,
        opening: float | None = None,
        clearance: float = 0.0,
        points_tcp: Floats | None = None,
        obstacle_height: HeightFunction | None = None,
        pile_clearance: float = 0.0,
    ) -> PathCheck:
        """Check the polyline through (W, 6) knots.

        Args:
            q: (W, 6) knots [rad].
            opening: Distance between the pads [m]; None for the open jaw.
            clearance: Smallest distance allowed between robot and cell [m].
            points_tcp: (P, 3) points on the gripper and on what it carries, tcp frame [m]; none if None.
            obstacle_height: Surface of the pile. Without it, the points are checked against table, bin and tray only.
            pile_clearance: Smallest height of the points above any surface [m].

        Note:
            About 15 us a sample, and 70 us for a thousand points at it.
        """
        require_shape("q", q, (None, DOF))
        if points_tcp is not None:
            require_shape("points_tcp", points_tcp, (None, 3))
        samples = self.refine(q)
        for posture in samples:
            contacts = self._scene.contacts(posture, opening=opening, clearance=clearance)
            if contacts:
                deepest = contacts[0]
                reason = f"{deepest.first} against {deepest.second}, {1e3 * deepest.distance:.1f} mm"
                return PathCheck(q_hit=posture, reason=reason)
        if points_tcp is None or len(points_tcp) == 0:
            return PathCheck()
        return self._check_points(samples, points_tcp, obstacle_height, pile_clearance)

    def refine(self, q: Floats) -> Floats:
        """Return (S, 6) samples of the polyline, so dense that tcp and joints move by little from one to the next."""
        if len(q) < 2:
            return q
        tips = self._scene.tcp_poses(q)[:, :3, 3]
        moved = np.linalg.norm(np.diff(tips, axis=0), axis=1) / _TIP_STEP
        turned = np.max(np.abs(np.diff(q, axis=0)), axis=1) / _JOINT_STEP
        counts = np.maximum(np.ceil(np.maximum(moved, turned)), 1).astype(int)
        pieces = [
            a + (b - a) * np.linspace(0, 1, n, endpoint=False)[:, None]
            for a, b, n in zip(q[:-1], q[1:], counts, strict=True)
        ]
        return np.concatenate([*pieces, q[-1:]])

    def _check_points(
        self, samples: Floats, points_tcp: Floats, obstacle_height: HeightFunction | None, pile_clearance: float
    ) -> PathCheck:
        poses = self._scene.tcp_poses(samples)
        flat = place_points(poses, np.ascontiguousarray(points_tcp))
        surface = self._scene.static_height(flat)
        if obstacle_height is not None:
            surface = np.maximum(surface, obstacle_height(flat))
        gap = (flat[:, 2] - surface).reshape(len(samples), -1).min(axis=1)
        hits = np.flatnonzero(gap < pile_clearance)
        if len(hits) == 0:
            return PathCheck()
        return PathCheck(q_hit=samples[hits[0]], reason=f"tool or part {1e3 * gap[hits[0]]:.1f} mm above the surface")

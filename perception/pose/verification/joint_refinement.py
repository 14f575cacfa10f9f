"""Refinement of a nearly right pose on the part's edges in the image and on the depth image at once.

Each kind of distance is weighted by its noise. An edge in the image is known to about a pixel whatever the noise of the
depth, and tells what a noisy depth does not: the two motions across the line of sight, and the rotation about it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from perception.geometry import NEAR, Floats
from perception.pose.model.appearances import SeenEdges
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.verification import _descent_kernels
from perception.pose.verification.refinement import (
    RefinedPose,
    refined_pose,
    require_common,
    require_depth,
    require_pose,
    view_direction,
)
from perception.pose.verification.verification import ObservedGroup

PATCH = 0.05  # largest reach of a patch, as a share of d_max


@dataclass(frozen=True, kw_only=True)
class JointRefinement:
    """Settings of the refinement on edges in the image and on the depth.

    Attributes:
        match_gate: Largest distance in space of an edge point and a boundary point that match, as a share of d_max.
        edge_gates: Largest distance of a match across the line of sight in each stage, as a share of d_max.
        surface_gate: Largest distance of a measured point from the model's surface, as a share of d_max.
        edge_noise: Standard deviation of an edge's place in the image [px]; the edge gates are at least three of them.
        depth_noise: Standard deviation of the depth [m]; a pose estimator puts that of each frame in its place. The
            match gate is at least four, the surface gate at least three of them.
        patch: Measured points up to this far from a sample's pixel count as its surface [px], but no farther than a
            twentieth of d_max.
        averaged: Standard deviation of their mean, as a share of that of one of them: neighbours share their errors.
        iterations: Largest number of steps in each stage.
        max_angle: Largest angle between the tangents of a match as lines [rad].
        damping: Number added to each eigenvalue of the Hessian per weighted match.
        observable: Eigenvalue of the same Hessian up to which a motion is left out of a step.
        still: Length of a step that ends a stage, as a share of d_max.
        min_matched: Share of the samples and edge points of the view that must be matched in the end.
    """

    match_gate: float = 0.03
    edge_gates: tuple[float, ...] = (0.015, 0.0075, 0.005)
    surface_gate: float = 0.02
    edge_noise: float = 0.7
    depth_noise: float = 0.0003
    patch: int = 2
    averaged: float = 0.5
    iterations: int = 8
    max_angle: float = float(np.deg2rad(25.0))
    damping: float = 1e-4
    observable: float = 1e-3
    still: float = 1e-5
    min_matched: float = 0.1

    def __post_init__(self) -> None:
        if len(self.edge_gates) == 0 or not all(0 < gate < np.inf for gate in self.edge_gates):
            raise ValueError(f"edge_gates must be positive and at least one, got {self.edge_gates}")
        for name in ("match_gate", "surface_gate", "edge_noise", "depth_noise"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        require_common(self.iterations, self.max_angle, self.damping, self.observable, self.still)
        if not 0 < self.averaged <= 1:
            raise ValueError(f"averaged must be in (0, 1], got {self.averaged}")
        if self.patch < 0:
            raise ValueError(f"patch must not be negative, got {self.patch}")
        if not 0 <= self.min_matched <= 1:
            raise ValueError(f"min_matched must be in [0, 1], got {self.min_matched}")


@dataclass(frozen=True, eq=False, kw_only=True)
class JointView:
    """What is matched with a frame in a pose and in those near it.

    Attributes:
        arguments: Arguments of `_descent_kernels.joint_equations` after the pose: edges and surface as seen in it,
            and the frame, with gates and weights.
        samples: Number of edge points and visible surface samples.
        depth_noise: Standard deviation of the distance of a patch of the depth [m].
    """

    arguments: tuple[Any, ...]
    samples: int
    depth_noise: float


def refine_jointly(
    T_cam_part: Floats,
    edges: SeenEdges,
    surface: SurfaceModel,
    group: ObservedGroup,
    config: JointRefinement | None = None,
) -> RefinedPose:
    """Refine a nearly right pose by fitting the part's edges to the image and its surface to the depth.

    An edge point is matched with the nearest boundary point of like tangent. Of their distance only what the image
    shows is minimised, since a depth beside an outline may be that of another surface.

    Args:
        T_cam_part: (4, 4) initial pose, off by less than the first gates.
        edges: Edge points of the part by direction of view.
        surface: Samples of the part's surface.
        group: Boundary points and their frame.
        config: Settings; the defaults of :class:`JointRefinement` if None.

    Raises:
        ValueError: The pose is not (4, 4) or not finite, or the frame has no depth.
    """
    config = config or JointRefinement()
    T = require_pose(T_cam_part)
    require_depth(group.frame)
    descent = (config.iterations, config.damping, config.observable, config.still)
    steps, settled, total, count, samples = 0, False, 0.0, 0, 0
    for share in config.edge_gates:
        view = joint_view(T, edges, surface, group, config, share)
        T, taken, settled, total, count = _descent_kernels.descend_jointly(T, view.arguments, *descent)
        steps, samples = steps + taken, view.samples
    return refined_pose(T, total, count, steps, settled, config.min_matched * samples)


def joint_view(
    T_cam_part: Floats,
    edges: SeenEdges,
    surface: SurfaceModel,
    group: ObservedGroup,
    config: JointRefinement,
    edge_gate: float,
) -> JointView:
    """Return what is matched with a frame in a pose and in those near it.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        edges: Edge points of the part by direction of view.
        surface: Samples of the part's surface.
        group: Boundary points and their frame.
        config: Settings.
        edge_gate: Largest distance of a match across the line of sight, as a share of d_max.
    """
    frame, d_max = group.frame, surface.d_max
    # What a pixel measures across the line of sight, at the part's centre; its origin may be far away.
    depth = float(T_cam_part[2, :3] @ surface.centre + T_cam_part[2, 3])
    pixel = max(depth, NEAR) / float(frame.K[0, 0])
    edge_noise, depth_noise = config.edge_noise * pixel, config.averaged * config.depth_noise
    points, tangents = edges.seen_from(view_direction(T_cam_part, edges.centre))
    visible = surface.visible(T_cam_part)
    arguments = (
        points,
        tangents,
        *group.boundary.arrays,
        max(config.match_gate * d_max, 4 * config.depth_noise),
        float(np.cos(config.max_angle)),
        max(edge_gate * d_max, 3 * edge_noise),
        (depth_noise / edge_noise) ** 2,
        surface.points,
        surface.normals,
        visible,
        frame.depth,
        frame.K,
        max(config.surface_gate * d_max, 3 * config.depth_noise),
        min(config.patch, int(PATCH * d_max / pixel)),
        surface.centre,
        d_max,
    )
    samples = len(points) + int(np.count_nonzero(visible))
    return JointView(arguments=arguments, samples=samples, depth_noise=depth_noise)

"""Verification: how well a pose agrees with the boundary points and the depth image."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perception.frame import Frame
from perception.geometry import Floats
from perception.pose.model.appearances import SeenEdges
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.verification import _verification_kernels
from perception.pose.verification.boundary_index import BoundaryIndex
from perception.pose.verification.refinement import require_depth, require_pose, view_direction

TOLERANCE = 3.0  # gap between two surfaces that agree, in standard deviations of the sensor's depth
# Distance along the line of sight at which an edge agrees, in units of the configuration's noise. In a noisy frame that
# is two thirds of the depth's standard deviation, so that three of these are tolerated.
EDGE_TOLERANCE = 4.5
OCCLUSION_RADIUS = 2  # an edge point is occluded if everything measured within this window lies before it [px]


@dataclass(frozen=True, kw_only=True)
class VerificationConfig:
    """Tolerances, and the coefficients of the logit that hypotheses are ranked by.

    The coefficients were fitted once to right and wrong hypotheses about tees and lids (2 230 of them, in scenes of
    seed 31), so that the right one of a group ranks first. `perception.pose.verification.confidence` gives the
    probability that it is right.

    Attributes:
        edge_distance: Largest distance between a model edge point and a boundary point, as a share of d_max; along the
            line of sight it may be more where the depth is noisy (`EDGE_TOLERANCE`).
        edge_angle: Largest angle between their tangents as lines [rad].
        surface_distance: Largest distance between the model's surface and the measured one, as a share of d_max.
        noise: Standard deviation of the sensor's depth; three of them are tolerated [m].
        window: Distance from a sample's pixel up to which the measured surface is searched [px].
        bias: Constant term of the logit.
        edge_weight: Coefficient of the edge score.
        explained_weight: Coefficient of the explained share of the group.
        support_weight: Coefficient of the support.
        violation_weight: Coefficient of the violation.
    """

    edge_distance: float = 0.03
    edge_angle: float = float(np.deg2rad(20.0))
    surface_distance: float = 0.02
    noise: float = 0.0003
    window: int = 1
    bias: float = -5.5
    edge_weight: float = 0.6
    explained_weight: float = 8.1
    support_weight: float = 2.9
    violation_weight: float = -21.5

    def __post_init__(self) -> None:
        for name in ("edge_distance", "surface_distance"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not 0 < self.edge_angle <= np.pi / 2:
            raise ValueError(f"edge_angle must be in (0, pi/2] rad, got {self.edge_angle}")
        if not 0 <= self.noise < np.inf:
            raise ValueError(f"noise must not be negative, got {self.noise}")
        if self.window < 0:
            raise ValueError(f"window must not be negative, got {self.window}")
        for name in ("bias", "edge_weight", "explained_weight", "support_weight", "violation_weight"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservedGroup:
    """A group of boundary points in its frame: everything that a pose is compared with.

    Attributes:
        points_cam: (N, 3) boundary points of the group, which a pose has to explain, camera frame [m].
        tangents_cam: (N, 3) unit tangents of these points, sign arbitrary.
        boundary: Index of all boundary points of the frame; an edge may have been assigned to another group.
        frame: Depth image and camera.
        noise: Standard deviation of the frame's depth [m].
    """

    points_cam: Floats
    tangents_cam: Floats
    boundary: BoundaryIndex
    frame: Frame
    noise: float = 0.0

    def only(self, chosen: NDArray[np.int64]) -> "ObservedGroup":
        """Return the group of some of the points, chosen by their indices, in the same frame."""
        return replace(self, points_cam=self.points_cam[chosen], tangents_cam=self.tangents_cam[chosen])


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Agreement of a pose with the boundary points and the depth image; shares are in [0, 1].

    Attributes:
        edge_score: Share of the visible edge points of the posed part, those that nothing occludes, which have a
            boundary point of like tangent near them.
        explained: Share of the group's boundary points that have an edge point of like tangent of the posed part
            near them.
        support: Share of the samples with a depth, self-occluded ones left out, that lie on the measured surface.
        violation: Share of the same samples that lie in front of the measured surface: the camera saw through them.
            Samples behind it are occluded by something else; they count neither as support nor as violation.
        measured: Share of the samples that are not self-occluded for which a depth was measured.
        logit: Weighted sum of the first four, by which the hypotheses of a group are ranked.
    """

    edge_score: float
    explained: float
    support: float
    violation: float
    measured: float
    logit: float

    @property
    def score(self) -> float:
        """Logistic function of the logit, in [0, 1]."""
        return float(0.5 * (1 + np.tanh(self.logit / 2)))

    @property
    def visible_fraction(self) -> float:
        """Share of the part's camera-facing surface that is visible, in [0, 1]."""
        return self.support * self.measured


def verify(
    T_cam_part: Floats,
    edges: SeenEdges,
    surface: SurfaceModel,
    group: ObservedGroup,
    config: VerificationConfig | None = None,
) -> Verdict:
    """Compare a pose with the boundary points and the depth image.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        edges: Edge points of the part by direction of view.
        surface: Samples of the part's surface.
        group: Boundary points that the pose has to explain, and their frame.
        config: Tolerances and coefficients; the defaults of :class:`VerificationConfig` if None.

    Raises:
        ValueError: The pose is not (4, 4) or not finite, or the frame has no depth.

    Note:
        A pose outside the image, or behind the camera, has support and violation 0.
    """
    config = config or VerificationConfig()
    T = require_pose(T_cam_part)
    require_depth(group.frame)
    edge_score, explained = edge_scores(T, edges, group, config)
    frame, tolerance = group.frame, surface_tolerance(edges.d_max, config)
    visible, known, on, before = _verification_kernels.gap_counts(
        T, surface.points, surface.normals, surface.visible(T), frame.depth, frame.K, config.window, tolerance
    )
    support, violation = (on / known, before / known) if known else (0.0, 0.0)
    return Verdict(
        edge_score=edge_score,
        explained=explained,
        support=support,
        violation=violation,
        measured=known / max(visible, 1),
        logit=ranking_logit(edge_score, explained, support, violation, config),
    )


def edge_scores(
    T_cam_part: Floats, edges: SeenEdges, group: ObservedGroup, config: VerificationConfig
) -> tuple[float, float]:
    """Return the edge score of a pose, and the share of the group that its edges explain; see :class:`Verdict`.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        edges: Edge points of the part by direction of view.
        group: Boundary points that the pose has to explain, and their frame.
        config: Tolerances.

    Raises:
        ValueError: The pose is not (4, 4) or not finite.
    """
    T = require_pose(T_cam_part)
    points, tangents = edges.seen_from(view_direction(T, edges.centre))
    gate, min_cosine = config.edge_distance * edges.d_max, float(np.cos(config.edge_angle))
    depth_gate = max(gate, EDGE_TOLERANCE * config.noise)
    frame, tolerance = group.frame, surface_tolerance(edges.d_max, config)
    matched, occluded, explained = _verification_kernels.edge_counts(
        T,
        points,
        tangents,
        *group.boundary.arrays,
        gate,
        depth_gate,
        min_cosine,
        frame.depth,
        frame.K,
        tolerance,
        OCCLUSION_RADIUS,
        group.points_cam,
        group.tangents_cam,
    )
    visible, size = len(points) - occluded, len(group.points_cam)
    return matched / visible if visible else 0.0, explained / size if size else 0.0


def ranking_logit(
    edge_score: float, explained: float, support: float, violation: float, config: VerificationConfig
) -> float:
    """Return the weighted sum of four shares, by which the hypotheses of a group are ranked."""
    return (
        config.bias
        + config.edge_weight * edge_score
        + config.explained_weight * explained
        + config.support_weight * support
        + config.violation_weight * violation
    )


def surface_tolerance(d_max: float, config: VerificationConfig) -> float:
    """Return the largest distance between the model's surface and the measured one with which they agree [m]."""
    return max(config.surface_distance * d_max, TOLERANCE * config.noise)

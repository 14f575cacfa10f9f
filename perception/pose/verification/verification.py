"""Whether a pose is right: its edges are seen, they explain what was seen, and its surface is where depth is."""

from dataclasses import dataclass

import numpy as np

from perception.frame import Frame
from perception.geometry import Floats
from perception.pose.model.appearances import SeenEdges
from perception.pose.model.surface_model import SurfaceModel
from perception.pose.verification import _refine_kernels, _verification_kernels
from perception.pose.verification.boundary_index import BoundaryIndex
from perception.pose.verification.refinement import require_depth, require_pose, view_direction

HIDING_RADIUS = 2  # an edge point is hidden if all that is measured so near to it lies before it [px]


@dataclass(frozen=True, kw_only=True)
class VerificationConfig:
    """Tolerances, and the coefficients of the evidence.

    These were fitted once to right and wrong hypotheses about tees and lids (2 230 of them, of scenes of seed 31), so
    that the right one of a group comes first; how sure a pose is, `perception.pose.verification.confidence` says.
    """

    edge_distance: float = 0.03  # from a model edge point to a boundary point, as a share of d_max
    edge_angle: float = float(np.deg2rad(20.0))  # between their tangents [rad]
    surface_distance: float = 0.02  # from the model's surface to the measured one, as a share of d_max
    noise: float = 0.0003  # the sensor's standard deviation of depth; three of them are tolerated [m]
    window: int = 1  # how far from a sample's pixel the measured surface is looked for [px]
    bias: float = -5.5  # of the evidence
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


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What speaks for a pose and what against it; shares in [0, 1].

    Attributes:
        edge_score: Of the edge points that the pose's view shows and nothing hides, with a boundary point near and
            along them.
        explained: Of the boundary points that the pose was found by, with an edge of the posed part near and along
            them.
        support: Of the samples that the part itself does not hide and where a depth was measured, on that surface.
        violation: Of the same samples, in front of it: the camera saw through them. Those behind it are hidden by
            something else and count as neither.
        measured: Of the samples that the part itself does not hide, with a depth.
        evidence: Weighted sum of the first four, by which the poses of a group are ranked.
    """

    edge_score: float
    explained: float
    support: float
    violation: float
    measured: float
    evidence: float

    @property
    def score(self) -> float:
        """Logistic of the evidence, in [0, 1]."""
        return float(0.5 * (1 + np.tanh(self.evidence / 2)))

    @property
    def visible_fraction(self) -> float:
        """Share of the part's camera-facing surface that is seen."""
        return self.support * self.measured


def verify(
    T_cam_part: Floats,
    model: SeenEdges,
    surface: SurfaceModel,
    boundary: BoundaryIndex,
    frame: Frame,
    group: tuple[Floats, Floats],
    config: VerificationConfig | None = None,
) -> Verdict:
    """Compare a pose with everything that was seen.

    Args:
        T_cam_part: (4, 4).
        model: The part's edges.
        surface: The part's surface.
        boundary: Of the whole scene: an edge may have been given to another group.
        frame: For depth and K.
        group: (N, 3) boundary points that the pose has to explain, camera frame [m], and their (N, 3) unit tangents.
        config: :class:`VerificationConfig`'s defaults if left out.

    Raises:
        ValueError: The pose is not (4, 4) or not finite, or the frame has no depth.

    Note:
        A pose outside the image, or behind the camera, has support and violation 0.
    """
    config = config or VerificationConfig()
    T = require_pose(T_cam_part)
    require_depth(frame)
    edges, explained = edge_scores(T, model, boundary, frame, group, config)
    gaps, measured = _gaps(T, surface, frame, config.window)
    tolerance = _tolerance(model.d_max, config)
    support = float(np.mean(np.abs(gaps) <= tolerance)) if len(gaps) else 0.0
    violation = float(np.mean(gaps > tolerance)) if len(gaps) else 0.0
    return Verdict(
        edge_score=edges,
        explained=explained,
        support=support,
        violation=violation,
        measured=measured,
        evidence=evidence(edges, explained, support, violation, config),
    )


def edge_scores(
    T_cam_part: Floats,
    model: SeenEdges,
    boundary: BoundaryIndex,
    frame: Frame,
    group: tuple[Floats, Floats],
    config: VerificationConfig,
) -> tuple[float, float]:
    """Return what share of the pose's unhidden edges was seen, and what share of the group they explain."""
    T = require_pose(T_cam_part)
    points, tangents = model.seen_from(view_direction(T, model.centre))
    gate, min_cosine = config.edge_distance * model.d_max, float(np.cos(config.edge_angle))
    matches = boundary.match(T, points, tangents, gate=gate, max_angle=config.edge_angle)
    tolerance = _tolerance(model.d_max, config)
    hidden = _verification_kernels.hidden_points(T, points, matches, frame.depth, frame.K, tolerance, HIDING_RADIUS)
    seen, unhidden = np.count_nonzero(matches >= 0), len(points) - np.count_nonzero(hidden)
    explained = _verification_kernels.explained_points(T, points, tangents, *group, gate, min_cosine)
    return float(seen / unhidden) if unhidden else 0.0, float(np.mean(explained)) if len(explained) else 0.0


def evidence(
    edge_score: float, explained: float, support: float, violation: float, config: VerificationConfig
) -> float:
    """Return the weighted sum of the four shares."""
    return (
        config.bias
        + config.edge_weight * edge_score
        + config.explained_weight * explained
        + config.support_weight * support
        + config.violation_weight * violation
    )


def _tolerance(d_max: float, config: VerificationConfig) -> float:
    return max(config.surface_distance * d_max, 3 * config.noise)


def _gaps(T: Floats, surface: SurfaceModel, frame: Frame, window: int) -> tuple[Floats, float]:
    """Return how far behind (+) or before (-) each visible sample a surface was measured [m], and for what share."""
    visible = surface.visible(T)
    gaps = _refine_kernels.surface_gaps(T, surface.points, surface.normals, visible, frame.depth, frame.K, window)
    known: Floats = gaps[~np.isnan(gaps)]
    return known, len(known) / max(int(np.count_nonzero(visible)), 1)

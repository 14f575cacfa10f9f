"""Whether a pose is right: its edges are seen, its surface is measured, and it does not float before it."""

from dataclasses import dataclass

import numpy as np

from perception.frame import Frame
from perception.geometry import Floats
from perception.pose import _refine_kernels
from perception.pose.boundary_index import BoundaryIndex
from perception.pose.edge_models import EdgeModel
from perception.pose.refinement import require_depth, require_pose, view_direction
from perception.pose.surface_model import SurfaceModel


@dataclass(frozen=True, kw_only=True)
class VerificationConfig:
    """Tolerances, and the coefficients of the score.

    The four coefficients are PLACEHOLDERS chosen by hand, so that an unhidden right pose comes near 1 and a pose at the
    customary limits (an edge score of 0.35, a violation of 0.1) below 0.3. They are not fitted to anything yet: until
    they are, on labelled scenes, a score ranks poses and is no probability.
    """

    edge_distance: float = 0.03  # from a model edge point to a boundary point, as a share of d_max
    edge_angle: float = float(np.deg2rad(20.0))  # between their tangents [rad]
    surface_distance: float = 0.02  # from the model's surface to the measured one, as a share of d_max
    noise: float = 0.0003  # the sensor's standard deviation of depth; three of them are tolerated [m]
    window: int = 1  # how far from a sample's pixel the measured surface is looked for [px]
    bias: float = -5.0  # of the score's logistic: a placeholder
    edge_weight: float = 7.0  # placeholder
    support_weight: float = 4.0  # placeholder
    violation_weight: float = -15.0  # placeholder

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
        for name in ("bias", "edge_weight", "support_weight", "violation_weight"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What speaks for a pose and what against it; shares in [0, 1].

    Attributes:
        edge_score: Of the edge points that the pose's view shows, with a boundary point near and along them.
        support: Of the samples that the part itself does not hide and where a depth was measured, on that surface.
        violation: Of the same samples, in front of it: the camera saw through them. Those behind it are hidden by
            something else and count as neither.
        measured: Of the samples that the part itself does not hide, with a depth.
        score: Logistic of the first three.
    """

    edge_score: float
    support: float
    violation: float
    measured: float
    score: float


def verify(
    T_cam_part: Floats,
    model: EdgeModel,
    surface: SurfaceModel,
    boundary: BoundaryIndex,
    frame: Frame,
    config: VerificationConfig | None = None,
) -> Verdict:
    """Compare a pose with everything that was seen.

    Args:
        T_cam_part: (4, 4).
        model: The part's edges.
        surface: The part's surface.
        boundary: Of the whole scene: an edge may have been given to another group.
        frame: For depth and K.
        config: :class:`VerificationConfig`'s defaults if left out.

    Raises:
        ValueError: The pose is not (4, 4) or not finite, or the frame has no depth.

    Note:
        A pose outside the image, or behind the camera, has support and violation 0.
    """
    config = config or VerificationConfig()
    T = require_pose(T_cam_part)
    require_depth(frame)
    edges = edge_score(T, model, boundary, config)
    gaps, measured = _gaps(T, surface, frame, config.window)
    tolerance = max(config.surface_distance * surface.d_max, 3 * config.noise)
    support = float(np.mean(np.abs(gaps) <= tolerance)) if len(gaps) else 0.0
    violation = float(np.mean(gaps > tolerance)) if len(gaps) else 0.0
    return Verdict(
        edge_score=edges,
        support=support,
        violation=violation,
        measured=measured,
        score=pose_score(edges, support, violation, config),
    )


def edge_score(T_cam_part: Floats, model: EdgeModel, boundary: BoundaryIndex, config: VerificationConfig) -> float:
    """Return the share of the edge points that a (4, 4) pose's view shows which have a boundary point."""
    T = require_pose(T_cam_part)
    shown = model.visible_from(view_direction(T, model.centre))
    if not shown.any():
        return 0.0
    matches = boundary.match(
        T,
        model.points[shown],
        model.tangents[shown],
        gate=config.edge_distance * model.d_max,
        max_angle=config.edge_angle,
    )
    return float(np.mean(matches >= 0))


def pose_score(edge_score: float, support: float, violation: float, config: VerificationConfig) -> float:
    """Return the logistic of the three shares, in [0, 1]; see :class:`VerificationConfig` for what it is worth."""
    weighted = config.edge_weight * edge_score + config.support_weight * support + config.violation_weight * violation
    return float(0.5 * (1 + np.tanh((config.bias + weighted) / 2)))


def _gaps(T: Floats, surface: SurfaceModel, frame: Frame, window: int) -> tuple[Floats, float]:
    """Return how far behind (+) or before (-) each visible sample a surface was measured [m], and for what share."""
    visible = surface.visible(T)
    gaps = _refine_kernels.surface_gaps(T, surface.points, surface.normals, visible, frame.depth, frame.K, window)
    known: Floats = gaps[~np.isnan(gaps)]
    return known, len(known) / max(int(np.count_nonzero(visible)), 1)

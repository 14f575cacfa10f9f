"""Poses made exact: point-to-line ICP on boundary points, then point-to-plane on the depth image.

Both are Gauss-Newton on SE(3). A motion that the matches do not tell, along parallel edges or about an axis of
symmetry, is left out of each step: the pose stays where it was.
"""

from dataclasses import dataclass

import numpy as np

from perception.frame import Frame
from perception.geometry import Floats, require_shape
from perception.pose.model.appearances import SeenEdges
from perception.pose.model.surface_model import SurfaceModel
from perception.pose.verification import _descent_kernels
from perception.pose.verification._descent_kernels import MIN_MATCHES
from perception.pose.verification.boundary_index import BoundaryIndex


@dataclass(frozen=True, kw_only=True)
class EdgeRefinement:
    """Point-to-line ICP; lengths are shares of d_max unless they say metres."""

    gates: tuple[float, ...] = (0.05, 0.02, 0.01)  # largest distance of a match, stage by stage
    finest: float = 0.0009  # no gate is smaller: three standard deviations of a good sensor's noise [m]
    iterations: int = 10  # of each stage
    max_angle: float = float(np.deg2rad(25.0))  # between the tangents of a match [rad]
    damping: float = 1e-3  # added to each freedom, in shares of a match
    observable: float = 5e-3  # freedoms that move the matches less than this, in shares of a match, are left out
    still: float = 1e-5  # a step shorter than this ends a stage
    min_matched: float = 0.1  # share of the view's edge points matched in the end; with fewer it has not converged

    def __post_init__(self) -> None:
        if len(self.gates) == 0 or not all(0 < gate < np.inf for gate in self.gates):
            raise ValueError(f"gates must be positive and at least one, got {self.gates}")
        _require_common(self.iterations, self.max_angle, self.damping, self.observable, self.still)
        if not 0 <= self.finest < np.inf:
            raise ValueError(f"finest must not be negative, got {self.finest}")
        if not 0 <= self.min_matched <= 1:
            raise ValueError(f"min_matched must be in [0, 1], got {self.min_matched}")


@dataclass(frozen=True, kw_only=True)
class SurfaceRefinement:
    """Point-to-plane steps on the depth image; lengths are shares of d_max unless they say metres."""

    gates: tuple[float, ...] = (0.06, 0.02)  # largest distance of a match, stage by stage; Tukey's weight is 0 there
    finest: float = 0.0009  # no gate is smaller: three standard deviations of a good sensor's noise [m]
    iterations: int = 5  # of each stage
    max_angle: float = float(np.deg2rad(40.0))  # between the model's normal and the measured one [rad]
    reach: int = 3  # of the central differences that give the measured normal [px]
    damping: float = 1e-3  # added to each freedom, in shares of a match
    observable: float = 1e-2  # freedoms that move the matches less than this, in shares of a match, are left out
    still: float = 1e-5  # a step shorter than this ends the refinement
    min_matched: float = 0.2  # share of the visible samples matched in the end; with fewer it has not converged

    def __post_init__(self) -> None:
        if len(self.gates) == 0 or not all(0 < gate < np.inf for gate in self.gates):
            raise ValueError(f"gates must be positive and at least one, got {self.gates}")
        _require_common(self.iterations, self.max_angle, self.damping, self.observable, self.still)
        if not 0 <= self.finest < np.inf:
            raise ValueError(f"finest must not be negative, got {self.finest}")
        if self.reach < 1:
            raise ValueError(f"reach must be at least 1 px, got {self.reach}")
        if not 0 <= self.min_matched <= 1:
            raise ValueError(f"min_matched must be in [0, 1], got {self.min_matched}")


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedPose:
    """What a refinement came to.

    Attributes:
        T_cam_part: (4, 4).
        error: Root mean square distance of the matches in this pose [m]; infinite if there are none.
        inliers: Matches in this pose.
        iterations: Steps taken.
        converged: Whether enough was matched and the last step was small; the pose is of no use otherwise.
    """

    T_cam_part: Floats
    error: float
    inliers: int
    iterations: int
    converged: bool


def refine_edges(
    T_cam_part: Floats, model: SeenEdges, boundary: BoundaryIndex, config: EdgeRefinement | None = None
) -> RefinedPose:
    """Move a pose until the edges its view shows lie on boundary points.

    Each such model point p is matched with the nearest boundary point q of like tangent t, and the sum of squares of
    ``(I - t t^T)(R p + t - q)`` is lowered, with a gate that closes from stage to stage.

    Args:
        T_cam_part: (4, 4) start, off by up to the first gate.
        model: The part's edges.
        boundary: Of a scene, or of one group.
        config: :class:`EdgeRefinement`'s defaults if left out.

    Raises:
        ValueError: The pose is not (4, 4) or not finite.
    """
    config = config or EdgeRefinement()
    T = require_pose(T_cam_part)
    steps, settled, total, count, points = 0, False, 0.0, 0, np.zeros((0, 3))
    for share in config.gates:
        points, tangents = model.seen_from(view_direction(T, model.centre))
        T, taken, settled, total, count = _descent_kernels.descend_edges(
            T,
            points,
            tangents,
            *boundary.arrays,
            max(share * model.d_max, config.finest),
            float(np.cos(config.max_angle)),
            model.centre,
            model.d_max,
            config.iterations,
            config.damping,
            config.observable,
            config.still,
        )
        steps += taken
    return _refined(T, total, count, steps, settled, config.min_matched * len(points))


def refine_surface(
    T_cam_part: Floats, surface: SurfaceModel, frame: Frame, config: SurfaceRefinement | None = None
) -> RefinedPose:
    """Move a nearly right pose until the part's visible surface lies on the measured one.

    A sample is matched with the measured point of the pixel it projects to, and its distance to it along the sample's
    own normal, which has no noise, is lowered; the normal of the organised cloud only decides what may match.

    Args:
        T_cam_part: (4, 4) start, off by less than the gate over most of the surface.
        surface: The part's surface.
        frame: For depth and K.
        config: :class:`SurfaceRefinement`'s defaults if left out.

    Raises:
        ValueError: The pose is not (4, 4) or not finite, or the frame has no depth.
    """
    config = config or SurfaceRefinement()
    T = require_pose(T_cam_part)
    require_depth(frame)
    steps, settled, total, count, visible = 0, False, 0.0, 0, np.zeros(0, np.bool_)
    for share in config.gates:
        visible = surface.visible(T)
        T, taken, settled, total, count = _descent_kernels.descend_surface(
            T,
            surface.points,
            surface.normals,
            visible,
            frame.depth,
            frame.K,
            max(share * surface.d_max, config.finest),
            float(np.cos(config.max_angle)),
            config.reach,
            surface.centre,
            surface.d_max,
            config.iterations,
            config.damping,
            config.observable,
            config.still,
        )
        steps += taken
    return _refined(T, total, count, steps, settled, config.min_matched * np.count_nonzero(visible))


def view_direction(T_cam_part: Floats, centre: Floats) -> Floats:
    """Return the (3,) unit direction from a part's centre to the camera, in the part frame."""
    towards: Floats = -_posed(T_cam_part, centre) @ T_cam_part[:3, :3]
    distance = float(np.linalg.norm(towards))
    return towards / distance if distance > 0 else np.array([0.0, 0.0, 1.0])  # inside the camera any will do


def require_pose(T_cam_part: Floats) -> Floats:
    """Return a (4, 4) finite pose as the kernels take it; raise ``ValueError`` for another."""
    require_shape("T_cam_part", T_cam_part, (4, 4))
    if not np.isfinite(T_cam_part).all():
        raise ValueError(f"T_cam_part must be finite, got {T_cam_part.tolist()}")
    return np.ascontiguousarray(T_cam_part, dtype=np.float64)


def require_depth(frame: Frame) -> None:
    """Raise ``ValueError`` if nothing was measured."""
    if not (frame.depth[::16, ::16].any() or frame.depth.any()):  # a look at some pixels is nearly always enough
        raise ValueError("the frame must have a depth somewhere, it is 0 everywhere")


def _posed(T: Floats, point: Floats) -> Floats:
    posed: Floats = T[:3, :3] @ point + T[:3, 3]
    return posed


def _refined(T: Floats, total: float, count: int, steps: int, settled: bool, wanted: float) -> RefinedPose:
    """Sum up a refinement that wanted so many matches."""
    return RefinedPose(
        T_cam_part=T,
        error=float(np.sqrt(total / count)) if count else float("inf"),
        inliers=count,
        iterations=steps,
        converged=bool(settled and count >= max(MIN_MATCHES, wanted)),
    )


def _require_common(iterations: int, max_angle: float, damping: float, observable: float, still: float) -> None:
    if iterations < 1:
        raise ValueError(f"iterations must be at least 1, got {iterations}")
    if not 0 < max_angle <= np.pi / 2:
        raise ValueError(f"max_angle must be in (0, pi/2] rad, got {max_angle}")
    for name, value in (("damping", damping), ("observable", observable), ("still", still)):
        if not 0 <= value < np.inf:
            raise ValueError(f"{name} must not be negative, got {value}")

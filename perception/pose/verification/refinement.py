"""Refinement of poses: point-to-line ICP on boundary points, then point-to-plane ICP on the depth image.

Both use Gauss-Newton steps on SE(3). Motions that the matches do not determine, such as along parallel edges or about
an axis of symmetry, are left out of each step.
"""

import math
from dataclasses import dataclass

import numpy as np

from perception.frame import Frame
from perception.geometry import Floats, require_shape
from perception.pose.model.appearances import SeenEdges
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.verification import _descent_kernels
from perception.pose.verification._descent_kernels import MIN_MATCHES
from perception.pose.verification.boundary_index import BoundaryIndex


@dataclass(frozen=True, kw_only=True)
class EdgeRefinement:
    """Settings of the point-to-line ICP on boundary points.

    Attributes:
        gates: Largest distance of a match in each stage, as a share of d_max.
        finest: Lower limit of the gates: three standard deviations of a good sensor's noise [m].
        iterations: Largest number of steps in each stage.
        max_angle: Largest angle between the tangents of a match as lines [rad].
        damping: Number added to each eigenvalue of the Hessian per match.
        observable: Eigenvalue of the Hessian per match up to which a motion is left out of a step.
        still: Length of a step that ends a stage, as a share of d_max.
        min_matched: Share of the view's edge points that must be matched in the end; with fewer it has not converged.
    """

    gates: tuple[float, ...] = (0.05, 0.02, 0.01)
    finest: float = 0.0009
    iterations: int = 10
    max_angle: float = float(np.deg2rad(25.0))
    damping: float = 1e-3
    observable: float = 5e-3
    still: float = 1e-5
    min_matched: float = 0.1

    def __post_init__(self) -> None:
        if len(self.gates) == 0 or not all(0 < gate < np.inf for gate in self.gates):
            raise ValueError(f"gates must be positive and at least one, got {self.gates}")
        require_common(self.iterations, self.max_angle, self.damping, self.observable, self.still)
        if not 0 <= self.finest < np.inf:
            raise ValueError(f"finest must not be negative, got {self.finest}")
        if not 0 <= self.min_matched <= 1:
            raise ValueError(f"min_matched must be in [0, 1], got {self.min_matched}")


@dataclass(frozen=True, kw_only=True)
class SurfaceRefinement:
    """Settings of the point-to-plane ICP on the depth image.

    Attributes:
        gates: Largest distance of a match in each stage, as a share of d_max; Tukey's weight is 0 there.
        finest: Lower limit of the gates: three standard deviations of a good sensor's noise [m].
        iterations: Largest number of steps in each stage.
        max_angle: Largest angle between the model's normal and the measured one [rad].
        reach: Half the distance of the pixels whose difference gives the measured normal [px].
        damping: Number added to each eigenvalue of the Hessian per match.
        observable: Eigenvalue of the Hessian per match up to which a motion is left out of a step.
        still: Length of a step that ends a stage, as a share of d_max.
        min_matched: Share of the visible samples that must be matched in the end; with fewer it has not converged.
    """

    gates: tuple[float, ...] = (0.06, 0.02)
    finest: float = 0.0009
    iterations: int = 5
    max_angle: float = float(np.deg2rad(40.0))
    reach: int = 3
    damping: float = 1e-3
    observable: float = 1e-2
    still: float = 1e-5
    min_matched: float = 0.2

    def __post_init__(self) -> None:
        if len(self.gates) == 0 or not all(0 < gate < np.inf for gate in self.gates):
            raise ValueError(f"gates must be positive and at least one, got {self.gates}")
        require_common(self.iterations, self.max_angle, self.damping, self.observable, self.still)
        if not 0 <= self.finest < np.inf:
            raise ValueError(f"finest must not be negative, got {self.finest}")
        if self.reach < 1:
            raise ValueError(f"reach must be at least 1 px, got {self.reach}")
        if not 0 <= self.min_matched <= 1:
            raise ValueError(f"min_matched must be in [0, 1], got {self.min_matched}")


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedPose:
    """Result of a refinement.

    Attributes:
        T_cam_part: (4, 4) refined pose of the part in the camera frame.
        error: Root mean square distance of the matches in this pose [m]; infinite without matches.
        inliers: Number of matches in this pose.
        iterations: Number of steps over all stages.
        converged: Whether enough points are matched and the last step was short; otherwise the pose is of no use.
    """

    T_cam_part: Floats
    error: float
    inliers: int
    iterations: int
    converged: bool


def refine_edges(
    T_cam_part: Floats, model: SeenEdges, boundary: BoundaryIndex, config: EdgeRefinement | None = None
) -> RefinedPose:
    """Refine a pose by fitting the part's visible edges to boundary points.

    Each edge point p of the pose's view is matched with the nearest boundary point q of like tangent u. The sum of
    squares of ``(I - u u^T)(R p + t - q)`` is minimised, with a gate that narrows from stage to stage.

    Args:
        T_cam_part: (4, 4) initial pose, off by up to the first gate.
        model: Edge points of the part by direction of view.
        boundary: Index of the boundary points of a scene, or of one group.
        config: Settings; the defaults of :class:`EdgeRefinement` if None.

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
    return refined_pose(T, total, count, steps, settled, config.min_matched * len(points))


def refine_surface(
    T_cam_part: Floats, surface: SurfaceModel, frame: Frame, config: SurfaceRefinement | None = None
) -> RefinedPose:
    """Refine a nearly right pose by fitting the part's visible surface to the measured one.

    A sample is matched with the measured point of the pixel that it projects to. The distance along the sample's own
    normal, which has no noise, is minimised. The measured normal only decides which samples may match.

    Args:
        T_cam_part: (4, 4) initial pose, off by less than the first gate over most of the surface.
        surface: Samples of the part's surface.
        frame: Depth image and camera.
        config: Settings; the defaults of :class:`SurfaceRefinement` if None.

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
    return refined_pose(T, total, count, steps, settled, config.min_matched * np.count_nonzero(visible))


def view_direction(T_cam_part: Floats, centre: Floats) -> Floats:
    """Return the (3,) unit direction from a part's centre to the camera, in the part frame."""
    towards: Floats = -_posed(T_cam_part, centre) @ T_cam_part[:3, :3]
    distance = math.sqrt(towards @ towards)
    return towards / distance if distance > 0 else np.array([0.0, 0.0, 1.0])  # at the camera any direction will do


def require_pose(T_cam_part: Floats) -> Floats:
    """Return a pose as contiguous float64; raise ``ValueError`` if it is not (4, 4) or not finite."""
    require_shape("T_cam_part", T_cam_part, (4, 4))
    if not np.isfinite(T_cam_part).all():
        raise ValueError(f"T_cam_part must be finite, got {T_cam_part.tolist()}")
    return np.ascontiguousarray(T_cam_part, dtype=np.float64)


def require_depth(frame: Frame) -> None:
    """Raise ``ValueError`` if the frame has no depth anywhere."""
    if not frame.has_depth:
        raise ValueError("the frame must have a depth somewhere, but it is 0 everywhere")


def _posed(T: Floats, point: Floats) -> Floats:
    posed: Floats = T[:3, :3] @ point + T[:3, 3]
    return posed


def refined_pose(T: Floats, total: float, count: int, steps: int, settled: bool, wanted: float) -> RefinedPose:
    """Return the result; ``total`` is the matches' sum of squares, and ``wanted`` of them are needed to converge."""
    return RefinedPose(
        T_cam_part=T,
        error=float(np.sqrt(total / count)) if count else float("inf"),
        inliers=count,
        iterations=steps,
        converged=bool(settled and count >= max(MIN_MATCHES, wanted)),
    )


def require_common(iterations: int, max_angle: float, damping: float, observable: float, still: float) -> None:
    """Raise ``ValueError`` for nonsense in the settings that all refinements share."""
    if iterations < 1:
        raise ValueError(f"iterations must be at least 1, got {iterations}")
    if not 0 < max_angle <= np.pi / 2:
        raise ValueError(f"max_angle must be in (0, pi/2] rad, got {max_angle}")
    for name, value in (("damping", damping), ("observable", observable), ("still", still)):
        if not 0 <= value < np.inf:
            raise ValueError(f"{name} must not be negative, got {value}")

"""Expected error of a pose: what the noise of edges and depth leaves open, by the curvature of the fit."""

from dataclasses import dataclass

import numpy as np

from perception.geometry import Floats
from perception.part import Symmetry
from perception.pose.model.appearances import SeenEdges
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.verification import _descent_kernels
from perception.pose.verification.joint_refinement import JointRefinement, joint_view
from perception.pose.verification.refinement import require_depth, require_pose
from perception.pose.verification.verification import ObservedGroup

# Errors of neighbouring samples are not independent: in stereo depth, those of right poses are this many times as large
# as independent ones would be. BENCHMARK.md has the same for other sensors.
CORRELATED = 4.5
UNKNOWN = 1.0  # share of d_max that a motion may measure which nothing determines, as a standard deviation


@dataclass(frozen=True, kw_only=True)
class ExpectedError:
    """Standard deviations of a pose's error in its worst direction.

    Attributes:
        rotation: Standard deviation of the rotation about the worst axis [rad]; turns about an axis of revolution do
            not count.
        translation: Standard deviation of the position of the part's centre along the worst direction [m].
    """

    rotation: float = 0.0
    translation: float = 0.0


def expected_error(
    T_cam_part: Floats,
    symmetry: Symmetry,
    edges: SeenEdges,
    surface: SurfaceModel,
    group: ObservedGroup,
    config: JointRefinement,
) -> ExpectedError:
    """Return the error to expect of a pose that the joint refinement has found.

    The inverse of the Hessian of the weighted squares is the covariance of the pose, as in any least squares (Press et
    al., Numerical Recipes, 15.6), times the square of `CORRELATED`. It knows noise, not wrong matches: a pose that is
    turned by a quarter has a small expected error, too.

    Args:
        T_cam_part: (4, 4) pose of the part in the camera frame.
        symmetry: Symmetry of the part.
        edges: Edge points of the part by direction of view.
        surface: Samples of the part's surface.
        group: Boundary points and their frame.
        config: Settings, with the noise of the frame's depth.

    Raises:
        ValueError: The pose is not (4, 4) or not finite, or the frame has no depth.
    """
    T = require_pose(T_cam_part)
    require_depth(group.frame)
    view = joint_view(T, edges, surface, group, config, config.edge_gates[-1])
    unmatched = np.full(len(view.arguments[0]), -1, np.int64)
    hessian = _descent_kernels.joint_equations(unmatched, T, *view.arguments)[0]
    arm = surface.d_max / 2
    information = hessian / (CORRELATED * view.depth_noise) ** 2 + np.eye(6) / (UNKNOWN * surface.d_max) ** 2
    motions = _counted_motions(T, symmetry)
    covariance = np.asarray(np.linalg.inv(motions @ information @ motions.T), np.float64)
    rotations, translations = covariance[:-3, :-3], covariance[-3:, -3:]
    return ExpectedError(rotation=_largest(rotations) / arm, translation=_largest(translations))


def _counted_motions(T_cam_part: Floats, symmetry: Symmetry) -> Floats:
    """Return an orthonormal basis (A + 3, 6) of the motions that a symmetry does not undo, the translations last."""
    if symmetry.sphere:
        turns = np.zeros((0, 3))
    elif symmetry.axis is None:
        turns = np.eye(3)
    else:  # the plane across the axis
        turns = np.linalg.svd((T_cam_part[:3, :3] @ symmetry.axis)[None])[2][1:]
    motions = np.zeros((len(turns) + 3, 6))
    motions[:-3, :3] = turns
    motions[-3:, 3:] = np.eye(3)
    return motions


def _largest(covariance: Floats) -> float:
    """Return the standard deviation in the worst direction of a (K, K) covariance; 0 for none."""
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) if len(covariance) else 0.0

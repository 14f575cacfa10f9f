"""Errors of estimated poses: the paper's criterion, ADD and ADD-S.

Poses are (4, 4) float64 ``T_cam_part``, in metres. E estimates, P true poses, N points.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from perception.geometry import Floats, require_shape, transform_points
from perception.part import PartModel

MAX_TRANSLATION = 0.10  # limit of the translation error as a share of d_max (section IV.C of the paper)
MAX_ROTATION = math.radians(5.0)  # limit of the rotation error (section IV.C of the paper) [rad]


@dataclass(frozen=True, kw_only=True)
class PoseError:
    """The two errors of the paper's criterion.

    Attributes:
        translation: Distance between the two positions of the part's centre [m].
        rotation: Smallest angle between the two orientations modulo the part's symmetry [rad].
    """

    translation: float
    rotation: float

    def __post_init__(self) -> None:
        for name in ("translation", "rotation"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must be 0 or more, got {getattr(self, name)}")


def pose_error(T_est: Floats, T_true: Floats, part: PartModel) -> PoseError:
    """Return the error of an estimated pose.

    Positions are compared at ``part.centre``, which every symmetry keeps in place. At another point, such as the origin
    of the drawing, a half turn about a symmetry axis would count as a translation.

    Args:
        T_est: (4, 4) estimated ``T_cam_part``.
        T_true: (4, 4) true ``T_cam_part``.
        part: Centre and symmetry of the part.

    Raises:
        ValueError: A pose is not (4, 4), or not finite.
    """
    require_pose(T_est, T_true)
    apart = transform_points(T_est, part.centre[None]) - transform_points(T_true, part.centre[None])
    return PoseError(
        translation=float(np.linalg.norm(apart)), rotation=part.symmetry.distance(T_est[:3, :3], T_true[:3, :3])
    )


def is_recognised(
    error: PoseError, d_max: float, *, max_translation: float = MAX_TRANSLATION, max_rotation: float = MAX_ROTATION
) -> bool:
    """Return whether a pose is recognised by the paper's criterion.

    Args:
        error: Error of the estimated pose.
        d_max: Diameter of the part [m].
        max_translation: Largest translation error that passes, as a share of ``d_max``.
        max_rotation: Largest rotation error that passes [rad].

    Raises:
        ValueError: ``d_max`` is not positive, or a limit is negative.
    """
    require_diameter(d_max)
    _require_limits(max_translation, max_rotation)
    return bool(error.translation <= max_translation * d_max and error.rotation <= max_rotation)


def recognition_distances(
    T_est: Floats,
    T_true: Floats,
    part: PartModel,
    *,
    max_translation: float = MAX_TRANSLATION,
    max_rotation: float = MAX_ROTATION,
) -> Floats:
    """Return the (E, P) translation errors [m] of the pairs that pass the paper's criterion; infinite for all others.

    :func:`perception.metrics.pose_recognition.judge_poses` takes these distances to judge by the paper's criterion.

    Args:
        T_est: (E, 4, 4) estimated poses.
        T_true: (P, 4, 4) true poses.
        part: Centre, diameter and symmetry of the part.
        max_translation: Largest translation error that passes, as a share of ``part.d_max``.
        max_rotation: Largest rotation error that passes [rad].

    Raises:
        ValueError: The poses are not (E, 4, 4) and (P, 4, 4), or not finite, or a limit is negative.
    """
    _require_limits(max_translation, max_rotation)
    for name, T in (("T_est", T_est), ("T_true", T_true)):
        require_shape(name, T, (None, 4, 4))
        _require_finite(name, T)
    distances = np.full((len(T_est), len(T_true)), np.inf)
    centres_est, centres_true = (T[:, :3, :3] @ part.centre + T[:, :3, 3] for T in (T_est, T_true))
    apart = np.linalg.norm(centres_est[:, None] - centres_true, axis=-1)
    # Positions alone rule out nearly all pairs; only the remaining ones need an angle.
    for e, p in np.argwhere(apart <= max_translation * part.d_max * (1 + 1e-9)):
        error = pose_error(T_est[e], T_true[p], part)
        if is_recognised(error, part.d_max, max_translation=max_translation, max_rotation=max_rotation):
            distances[e, p] = error.translation
    return distances


def add(T_est: Floats, T_true: Floats, points: Floats) -> float:
    """Return ADD [m]: the mean distance between the (N, 3) model points in the two poses, without symmetry.

    Source: Hinterstoisser et al., "Model Based Training, Detection and Pose Estimation of Texture-Less 3D Objects in
    Heavily Cluttered Scenes", ACCV 2012. By convention, an estimate is right below a tenth of the diameter.

    Args:
        T_est: (4, 4) estimated pose.
        T_true: (4, 4) true pose.
        points: (N, 3) model points in the part frame [m]. By convention they are the vertices of the mesh; samples of
            the surface do not depend on its triangulation.

    Raises:
        ValueError: A pose is not (4, 4) and finite, or there is no point.
    """
    est, true = _posed(T_est, T_true, points)
    return float(np.linalg.norm(est - true, axis=1).mean())


def add_s(T_est: Floats, T_true: Floats, points: Floats) -> float:
    """Return ADD-S (ADI) [m]: the mean distance from the points in the true pose to the nearest in the estimated one.

    It needs no declared symmetry, but also forgives errors that no symmetry explains. It is not symmetric in its
    arguments. Source: as :func:`add`.

    Args:
        T_est: (4, 4) estimated pose.
        T_true: (4, 4) true pose.
        points: (N, 3) model points in the part frame [m].

    Raises:
        ValueError: A pose is not (4, 4) and finite, or there is no point.
    """
    est, true = _posed(T_est, T_true, points)
    return float(np.mean(KDTree(est).query(true)[0]))


def require_pose(T_est: Floats, T_true: Floats) -> None:
    """Raise ``ValueError`` unless both are (4, 4) and finite."""
    for name, T in (("T_est", T_est), ("T_true", T_true)):
        require_shape(name, T, (4, 4))
        _require_finite(name, T)


def require_diameter(d_max: float) -> None:
    """Raise ``ValueError`` unless ``d_max`` is positive."""
    if not d_max > 0:
        raise ValueError(f"d_max must be positive, got {d_max}")


def _require_finite(name: str, T: Floats) -> None:
    if not np.isfinite(T).all():
        raise ValueError(f"{name} must be finite, got {T.tolist()}")


def _require_limits(max_translation: float, max_rotation: float) -> None:
    if not (max_translation >= 0 and max_rotation >= 0):
        raise ValueError(f"the limits must be 0 or more, got {max_translation} of d_max and {max_rotation} rad")


def _posed(T_est: Floats, T_true: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return the (N, 3) points in the two poses."""
    require_pose(T_est, T_true)
    require_shape("points", points, (None, 3))
    if len(points) == 0:
        raise ValueError("points must hold at least one point, got none")
    return transform_points(T_est, points), transform_points(T_true, points)

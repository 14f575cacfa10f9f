"""Thinning of boundary points: one of several that lie close together on the same line is enough to vote."""

import math

import numpy as np

from perception.geometry import Floats, require_shape
from perception.pose.model._pair_kernels import Ints
from perception.pose.model._thinning_kernels import keep_first
from perception.pose.model.pair_features import unit, usable

_ROUNDING = 1e-12  # of a dot product of unit vectors: equal tangents differ by 0, square ones by pi / 2


def thin_points(points: Floats, tangents: Floats, radius: float, angle: float) -> Ints:
    """Return the indices of the points that stay, ascending.

    First come, first kept: a point is left out if one kept before it lies within ``radius`` and their tangents, as
    lines, differ by at most ``angle``. Edges that cross keep a point each.

    Args:
        points: (N, 3) [m]; those that are not finite are left out.
        tangents: (N, 3) directions of their edges, of either sign and any length; points with none are left out.
        radius: [m].
        angle: In [0, pi/2]; pi/2 for any two tangents [rad].

    Returns:
        (K,) int64.

    Note:
        Deterministic, and exact to the last bit of a distance. 0.2 ms for 2000 points and 4 ms for 25 000.
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

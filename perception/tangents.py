"""Tangents of boundary points from their neighbours in space, where there is no image to take them from."""

import numpy as np
from scipy.spatial import cKDTree

from perception.geometry import Floats, require_shape

NEIGHBOURS = 30  # number of neighbours that a tangent is fitted to, the point itself included
REACH = 0.06  # distance up to which a point counts as a neighbour, as a share of d_max
FEWEST = 3  # number of neighbours below which a point has no tangent


def space_tangents(points: Floats, d_max: float) -> tuple[Floats, Floats]:
    """Return the tangents of boundary points, and how straight the edge is at each.

    The tangent is the principal axis of the nearest points. The straightness is the share of the spread that the other
    axes lack: 1 on a straight edge, near 0 in clutter.

    Args:
        points: (N, 3) boundary points [m].
        d_max: Largest extent of the part [m].

    Returns:
        (N, 3) unit tangents of arbitrary sign, 0 where a point has no neighbours, and (N,) straightness in [0, 1].

    Raises:
        ValueError: The shape of the points is another one, a point is not finite, or ``d_max`` is not positive.
    """
    require_shape("points", points, (None, 3))
    if not 0 < d_max < np.inf:
        raise ValueError(f"d_max must be positive and finite, got {d_max}")
    if not np.isfinite(points).all():
        raise ValueError("points must be finite: leave out pixels without a measurement")
    if len(points) == 0:
        return np.zeros((0, 3)), np.zeros(0)
    ranks = np.arange(1, min(NEIGHBOURS, len(points)) + 1)
    distances, nearest = cKDTree(points).query(points, ranks)
    near = np.asarray(distances <= REACH * d_max)[..., None]
    count = near.sum(axis=1)
    offsets = np.where(near, points[nearest] - points[:, None], 0.0)
    offsets = np.where(near, offsets - offsets.sum(axis=1, keepdims=True) / count[:, None], 0.0)
    spreads, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    known = (count[:, 0] >= FEWEST) & (spreads[:, 2] > 0)
    straight = 1.0 - np.divide(spreads[:, 1], spreads[:, 2], out=np.ones(len(points)), where=known)
    return np.where(known[:, None], axes[:, :, 2], 0.0), np.clip(straight, 0.0, 1.0)

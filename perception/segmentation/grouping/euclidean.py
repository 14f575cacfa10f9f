"""The floor under every network: points that lie close together are one part."""

import numpy as np
from numpy.typing import NDArray

from perception.geometry import require_shape
from perception.instance import Instance, instances_of
from perception.segmentation.grouping import _kernels
from perception.segmentation.grouping.similarity import require_finite


def euclidean_components(points: NDArray[np.floating], radius: float, min_points: int) -> list[Instance]:
    """Return the connected components of points linked when at most ``radius`` apart, largest first.

    Args:
        points: (N, 3) [m], any frame.
        radius: [m].
        min_points: Smaller components are left out.

    Returns:
        Instances; the score is a component's size relative to the largest one's, there being no confidence.

    Raises:
        ValueError: A shape, a point that is not finite, radius <= 0 or a radius too small for the cloud's extent.

    Note:
        Exact. O(N) memory whatever the radius: points are put into a grid whose cells are components of themselves,
        and only pairs of points in cells not yet joined are looked at.
    """
    require_shape("points", points, (None, 3))
    require_finite("points", points)
    if not 0 < radius < np.inf:
        raise ValueError(f"radius must be positive and finite, got {radius}")
    if min_points < 1:
        raise ValueError(f"min_points must be 1 or more, got {min_points}")
    if len(points) == 0:
        return []
    labels = _components(points.astype(np.float64), float(radius))
    sizes = np.bincount(labels)
    kept = sizes >= min_points
    renumbered = np.where(kept, np.cumsum(kept) - 1, -1)
    return instances_of(renumbered[labels], sizes[kept] / sizes.max())


def _components(points: NDArray[np.float64], radius: float) -> NDArray[np.int64]:
    """Return the (N,) component of each point, numbered in the order of their first points."""
    # A cell's diagonal is a hair under the radius; a point's partners are then at most two cells away on each axis.
    places = (points - points.min(axis=0)) / (radius * (1 - 1e-6) / np.sqrt(3))
    width, height, depth = (float(n) + 5 for n in np.floor(places.max(axis=0)))
    if not width * height * depth < 2**62:
        raise ValueError(f"radius {radius} is too small for a cloud of extent {np.ptp(points, axis=0).tolist()}")
    strides = np.array([int(height) * int(depth), int(depth)])
    cells = np.floor(places).astype(np.int64)
    key = cells[:, 0] * strides[0] + cells[:, 1] * strides[1] + cells[:, 2]
    keys, cell, counts = np.unique(key, return_inverse=True, return_counts=True)
    starts = np.append(0, np.cumsum(counts))
    linked = _kernels.linked_cells(points[np.argsort(key, kind="stable")], keys, starts, strides, radius)[cell]
    _, first, component = np.unique(linked, return_index=True, return_inverse=True)
    labels: NDArray[np.int64] = np.argsort(np.argsort(first))[component]
    return labels

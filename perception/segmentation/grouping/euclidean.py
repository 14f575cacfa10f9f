"""Euclidean clustering: points that lie close together are one part. The baseline of every network."""

import numpy as np
from numpy.typing import NDArray

from perception.geometry import require_shape
from perception.instance import Instance, instances_of
from perception.segmentation.grouping import _kernels
from perception.segmentation.grouping.similarity import require_finite


def euclidean_components(points: NDArray[np.floating], radius: float, min_points: int) -> list[Instance]:
    """Return the connected components of points linked when at most ``radius`` apart, largest first.

    Args:
        points: (N, 3) points in any frame [m].
        radius: Largest distance between linked points [m].
        min_points: Number of points of the smallest component that is returned.

    Returns:
        Instances; the score is the size of a component relative to the largest one, as there is no confidence.

    Raises:
        ValueError: Points are not (N, 3) and finite, or the radius is not positive or too small for the extent.

    Note:
        The result is exact, and memory is O(N) for any radius. Points are sorted into a grid whose cells are so small
        that the points of a cell are linked. Only pairs of points in cells that are not linked yet are compared.
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
    # The diagonal of a cell is just under the radius, so linked points are at most two cells apart on each axis.
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

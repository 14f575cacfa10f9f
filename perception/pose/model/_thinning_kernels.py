"""Compiled kernel of thinning: arrays in, arrays out, no threads and no fast maths (same arrays, same bits)."""

import math

import numpy as np
from numba import njit

from perception.geometry import Floats
from perception.pose.model._pair_kernels import Ints

_MOST_CELLS = float(1 << 20)  # from the origin along each axis; points farther away share the outermost cell


@njit(cache=True, nogil=True)
def _cell(value: float, density: float) -> int:
    """Return the cell of a coordinate, which never falls as the coordinate rises."""
    return int(min(max(math.floor(value * density), -_MOST_CELLS), _MOST_CELLS))


@njit(cache=True, nogil=True)
def _bucket(x: int, y: int, z: int, mask: int) -> int:
    """Return the hash of a cell."""
    # The primes of Teschner et al., "Optimized Spatial Hashing for Collision Detection", VMV 2003.
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & mask


@njit(cache=True, nogil=True)
def keep_first(points: Floats, tangents: Floats, radius: float, cosine: float) -> Ints:
    """Return the ascending indices of the points that are not like an earlier kept point.

    Two points are alike if they lie within ``radius`` and ``|dot| >= cosine`` holds for their tangents. Kept points are
    in linked lists by a hash of their cell. A ball of the radius reaches into at most two cells along each axis. Cells
    that share a list cost time, not correctness.

    Args:
        points: (N, 3) finite points [m].
        tangents: (N, 3) unit tangents.
        radius: Largest distance of points that are alike, positive [m].
        cosine: Cosine of the largest angle between the tangents of points that are alike.
    """
    mask = 255
    while mask < len(points):
        mask = 2 * mask + 1
    latest = np.full(mask + 1, -1, np.int32)  # kept point at the head of each list
    before = np.empty(len(points), np.int32)  # next point in the list of each kept point, -1 at the end
    kept = np.empty(len(points), np.int64)
    count = 0
    # The reach is a little larger than the radius, because a difference may be rounded down to it.
    reach, density = radius * (1 + 1e-9), 0.4 / radius
    for i in range(len(points)):
        # Look for a kept point like this one in all cells within reach.
        x, y, z = points[i]
        alone = True
        for a in range(_cell(x - reach, density), _cell(x + reach, density) + 1):
            for b in range(_cell(y - reach, density), _cell(y + reach, density) + 1):
                for c in range(_cell(z - reach, density), _cell(z + reach, density) + 1):
                    j = latest[_bucket(a, b, c, mask)]
                    while alone and j >= 0:
                        dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
                        if dx * dx + dy * dy + dz * dz <= radius * radius:
                            s, t = tangents[i], tangents[j]
                            alone = abs(s[0] * t[0] + s[1] * t[1] + s[2] * t[2]) < cosine
                        j = before[j]
                    if not alone:
                        break
                if not alone:
                    break
            if not alone:
                break
        # Keep the point, at the head of its cell's list.
        if alone:
            bucket = _bucket(_cell(x, density), _cell(y, density), _cell(z, density), mask)
            before[i], latest[bucket] = latest[bucket], i
            kept[count] = i
            count += 1
    return kept[:count]

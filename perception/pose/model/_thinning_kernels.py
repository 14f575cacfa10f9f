"""Compiled kernel of thinning: arrays in, arrays out, no threads and no fast maths (same arrays, same bits)."""

import math

import numpy as np
from numba import njit

from perception.geometry import Floats
from perception.pose.model._pair_kernels import Ints

_MOST_CELLS = float(1 << 20)  # from the origin, along each axis: what lies farther shares the outermost cell


@njit(cache=True, nogil=True)
def _cell(value: float, density: float) -> int:
    """Return the cell of a coordinate; a larger coordinate never has a smaller cell."""
    return int(min(max(math.floor(value * density), -_MOST_CELLS), _MOST_CELLS))


@njit(cache=True, nogil=True)
def _bucket(x: int, y: int, z: int, mask: int) -> int:
    # The primes of Teschner et al., "Optimized Spatial Hashing for Collision Detection", VMV 2003.
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & mask


@njit(cache=True, nogil=True)
def keep_first(points: Floats, tangents: Floats, radius: float, cosine: float) -> Ints:
    """Return the ascending indices of the points that have no earlier kept one like them.

    One is like another if it lies within ``radius`` and their tangents' ``|dot| >= cosine``. Kept points hang in lists
    by a hash of their cell; a ball reaches into two cells along each axis at most. Cells that share a list cost time,
    not correctness.

    Args:
        points: (N, 3) finite.
        tangents: (N, 3) unit.
        radius: Positive.
        cosine: Of the largest angle.
    """
    mask = 255
    while mask < len(points):
        mask = 2 * mask + 1
    latest = np.full(mask + 1, -1, np.int32)  # kept point of a list ...
    before = np.empty(len(points), np.int32)  # ... and the one after it, down to -1
    kept = np.empty(len(points), np.int64)
    count = 0
    # A difference that rounds to the radius may be a little larger.
    reach, density = radius * (1 + 1e-9), 0.4 / radius
    for i in range(len(points)):
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
        if alone:
            bucket = _bucket(_cell(x, density), _cell(y, density), _cell(z, density), mask)
            before[i], latest[bucket] = latest[bucket], i
            kept[count] = i
            count += 1
    return kept[:count]

"""Compiled kernels of motion planning. Arrays in, arrays out; lengths [m]."""
# mypy: disable-error-code="untyped-decorator, no-any-return"

import numpy as np
from numba import njit

from perception.geometry import Floats


@njit(cache=True)
def place_points(T_a_b: Floats, points_b: Floats) -> Floats:
    """Map (P, 3) points by each of (S, 4, 4) transforms to (S P, 3), transform by transform.

    The sums run x, z, y, as in numpy's einsum, so that the bits are the same.
    """
    out = np.empty((len(T_a_b) * len(points_b), 3))
    for s in range(len(T_a_b)):
        T = T_a_b[s]
        for p in range(len(points_b)):
            row = s * len(points_b) + p
            x, y, z = points_b[p, 0], points_b[p, 1], points_b[p, 2]
            for k in range(3):
                out[row, k] = T[k, 0] * x + T[k, 2] * z + T[k, 1] * y + T[k, 3]
    return out


@njit(cache=True)
def box_heights(points: Floats, places: Floats, rotations: Floats, sizes: Floats) -> Floats:
    """Return the (N,) z of the highest of B upright boxes over or under each of (N, 3) points, -inf beside all.

    The boxes have centres ``places`` (B, 3), rotation matrices ``rotations`` (B, 9), row by row, and half sizes
    ``sizes`` (B, 3).
    """
    out = np.full(len(points), -np.inf)
    for b in range(len(places)):
        R = rotations[b]
        top = places[b, 2] + sizes[b, 2]
        for n in range(len(points)):
            x, y, z = points[n, 0] - places[b, 0], points[n, 1] - places[b, 1], points[n, 2] - places[b, 2]
            along, across = x * R[0] + y * R[3] + z * R[6], x * R[1] + y * R[4] + z * R[7]
            if abs(along) <= sizes[b, 0] and abs(across) <= sizes[b, 1] and top > out[n]:
                out[n] = top
    return out

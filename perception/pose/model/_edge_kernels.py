"""Compiled kernel of chains of edge samples: arrays in, arrays out, no threads and no fast maths."""

import numpy as np
from numba import njit

from perception.geometry import Floats
from perception.pose.model._pair_kernels import Ints


@njit(cache=True, nogil=True)
def scatter(points: Floats, pairs: Ints, chain: Ints) -> Floats:
    """Return the (N, 3, 3) covariance of each of (N, 3) points and its neighbours on the same chain.

    Args:
        points: (N, 3) points [m].
        pairs: (P, 2) indices of points near each other, each pair once.
        chain: (N,) chain of each point.
    """
    count = np.ones(len(points))
    total, square = np.zeros((len(points), 3)), np.zeros((len(points), 3, 3))
    for direction in range(2):  # every pair as (point, neighbour) and as (neighbour, point)
        for p in range(len(pairs)):
            n, m = pairs[p, direction], pairs[p, 1 - direction]
            if chain[n] != chain[m]:
                continue
            count[n] += 1.0
            for i in range(3):
                offset = points[m, i] - points[n, i]
                total[n, i] += offset
                for j in range(3):
                    square[n, i, j] += offset * (points[m, j] - points[n, j])
    out = np.empty((len(points), 3, 3))
    for n in range(len(points)):
        for i in range(3):
            for j in range(3):
                out[n, i, j] = square[n, i, j] / count[n] - (total[n, i] / count[n]) * (total[n, j] / count[n])
    return out

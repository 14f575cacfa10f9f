"""Compiled kernel of collisions: arrays in, arrays out, no threads and no fast maths."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats


@njit(cache=True, nogil=True)
def samples_within(
    T: Floats, samples: Floats, inside: NDArray[np.float32], origin: Floats, cell: float, depth: float
) -> int:
    """Return the number of samples of one part that lie more than ``depth`` below the surface of another.

    Args:
        T: (4, 4) transform from the frame of the samples to that of the grid.
        samples: (M, 3) points on the surface of the one part [m].
        inside: (X, Y, Z) depth below the surface of the other part at the points of a grid, negative outside [m].
        origin: (3,) first point of the grid [m].
        cell: Distance between neighbouring points of the grid [m].
        depth: Least depth of a sample that counts [m].
    """
    found = 0
    for m in range(len(samples)):
        # Coordinates of the sample in cells of the grid.
        a, b, c = samples[m, 0], samples[m, 1], samples[m, 2]
        x = (T[0, 0] * a + T[0, 1] * b + T[0, 2] * c + T[0, 3] - origin[0]) / cell
        y = (T[1, 0] * a + T[1, 1] * b + T[1, 2] * c + T[1, 3] - origin[1]) / cell
        z = (T[2, 0] * a + T[2, 1] * b + T[2, 2] * c + T[2, 3] - origin[2]) / cell
        if not (0 <= x < inside.shape[0] - 1 and 0 <= y < inside.shape[1] - 1 and 0 <= z < inside.shape[2] - 1):
            continue
        # Trilinear interpolation of the depth between the eight surrounding points.
        i, j, k = int(x), int(y), int(z)
        u, v, w = x - i, y - j, z - k
        low = (1 - u) * (1 - v) * inside[i, j, k] + u * (1 - v) * inside[i + 1, j, k]
        low += (1 - u) * v * inside[i, j + 1, k] + u * v * inside[i + 1, j + 1, k]
        high = (1 - u) * (1 - v) * inside[i, j, k + 1] + u * (1 - v) * inside[i + 1, j, k + 1]
        high += (1 - u) * v * inside[i, j + 1, k + 1] + u * v * inside[i + 1, j + 1, k + 1]
        if (1 - w) * low + w * high > depth:
            found += 1
    return found

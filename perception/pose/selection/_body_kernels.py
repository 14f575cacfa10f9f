"""Compiled kernels of collisions: arrays in, arrays out, no threads and no fast maths."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.pose._transform_kernels import apply


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


@njit(cache=True, nogil=True)
def _relative(T_cam_a: Floats, T_cam_b: Floats) -> Floats:
    """Return the (4, 4) transform ``T_a_b``."""
    out = np.zeros((4, 4))
    out[3, 3] = 1.0
    for i in range(3):
        for k in range(3):
            out[i, 3] += T_cam_a[k, i] * (T_cam_b[k, 3] - T_cam_a[k, 3])
            for j in range(3):
                out[i, j] += T_cam_a[k, i] * T_cam_b[k, j]
    return out


@njit(cache=True, nogil=True)
def samples_shared(
    T_cam_a: Floats,
    T_cam_b: Floats,
    middle: Floats,
    radius: float,
    samples: Floats,
    inside: NDArray[np.float32],
    origin: Floats,
    cell: float,
    depth: float,
) -> int:
    """Return the number of samples of two copies of a part that lie more than ``depth`` below the other's surface.

    Args:
        T_cam_a: (4, 4) pose of the one copy in the camera frame.
        T_cam_b: (4, 4) pose of the other one.
        middle: (3,) centre of a ball that encloses the part, part frame [m].
        radius: Radius of this ball [m].
        samples: (M, 3) points on the part's surface, part frame [m].
        inside: (X, Y, Z) depth below the surface, see :func:`samples_within`.
        origin: (3,) first point of the grid, part frame [m].
        cell: Distance between neighbouring points of the grid [m].
        depth: Least depth of a sample that counts [m].
    """
    ax, ay, az = apply(T_cam_a, middle[0], middle[1], middle[2])
    bx, by, bz = apply(T_cam_b, middle[0], middle[1], middle[2])
    if (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2 >= (2 * radius) ** 2:  # most pairs of a bin are far apart
        return 0
    found = samples_within(_relative(T_cam_b, T_cam_a), samples, inside, origin, cell, depth)
    return found + samples_within(_relative(T_cam_a, T_cam_b), samples, inside, origin, cell, depth)

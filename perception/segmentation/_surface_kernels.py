"""Compiled kernels of surfaces: arrays in, arrays out, no threads and no fast maths (same arrays, same bits).

Images are (H, W), indexed [v, u]; depth is 0 where there is no measurement.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Singles = NDArray[np.float32]


@njit(cache=True, nogil=True)
def nearest_surface(depth: Singles, u0: int, v0: int, cell: float, shape: tuple[int, int], step: float) -> Singles:
    """Return the (h, w) mean depth of the nearest surface in square cells of the image, 0 where there is none.

    A pixel belongs to the cell that contains its centre. The depths within ``step`` of the smallest one in a cell are
    averaged, so that no value lies between two surfaces.

    Args:
        depth: (H, W) depth [m], 0 where there is no measurement.
        u0: Pixel column of the left border of the first cell.
        v0: Pixel row of the upper border of the first cell.
        cell: Side of a cell [px].
        shape: Number of rows and columns of cells (h, w).
        step: Largest difference of depths of one surface [m].
    """
    height, width = depth.shape
    rows, columns = shape
    nearest = np.full((rows, columns), np.inf, np.float32)
    total = np.zeros((rows, columns), np.float64)
    count = np.zeros((rows, columns), np.int64)
    # The smallest depth in each cell.
    v1, u1 = min(int(v0 + np.ceil(rows * cell)), height), min(int(u0 + np.ceil(columns * cell)), width)
    for v in range(max(v0, 0), v1):
        r = int((v - v0 + 0.5) / cell)
        if r >= rows:
            continue
        for u in range(max(u0, 0), u1):
            c = int((u - u0 + 0.5) / cell)
            z = depth[v, u]
            if z > 0 and c < columns and z < nearest[r, c]:
                nearest[r, c] = z
    # Sums over the depths on the nearest surface, then their means.
    for v in range(max(v0, 0), v1):
        r = int((v - v0 + 0.5) / cell)
        if r >= rows:
            continue
        for u in range(max(u0, 0), u1):
            c = int((u - u0 + 0.5) / cell)
            z = depth[v, u]
            if z > 0 and c < columns and z <= nearest[r, c] + step:
                total[r, c] += z
                count[r, c] += 1
    out = np.zeros((rows, columns), np.float32)
    for r in range(rows):
        for c in range(columns):
            if count[r, c] > 0:
                out[r, c] = total[r, c] / count[r, c]
    return out

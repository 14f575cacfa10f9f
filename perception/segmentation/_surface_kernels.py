"""Compiled kernels of surfaces: arrays in, arrays out, no threads and no fast maths (same arrays, same bits).

Images are (H, W), indexed [v, u]; depth is 0 where there is no measurement.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Singles = NDArray[np.float32]


@njit(cache=True, nogil=True)
def nearest_surface(depth: Singles, u0: int, v0: int, cell: float, shape: tuple[int, int], step: float) -> Singles:
    """Return (h, w) mean depth of the nearest surface in each square of ``cell`` pixels from (u0, v0), 0 for none.

    A pixel belongs to the square that its middle is in. Of a square's depths those within ``step`` of the smallest are
    averaged, so that no value lies between two surfaces.
    """
    height, width = depth.shape
    rows, columns = shape
    nearest = np.full((rows, columns), np.inf, np.float32)
    total = np.zeros((rows, columns), np.float64)
    count = np.zeros((rows, columns), np.int64)
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

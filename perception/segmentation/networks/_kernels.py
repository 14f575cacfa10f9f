"""Compiled kernel of the context network."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def neighbour_max(rows: Singles, neighbours: Ints) -> tuple[Singles, Ints]:
    """Return the (M, C) maxima of (N, C) rows over (M, K) neighbours, and the (M, C) neighbours that have them.

    The first of equal ones counts, and the first neighbour where it is NaN.
    """
    count, k = neighbours.shape
    channels = rows.shape[1]
    largest = np.empty((count, channels), np.float32)
    source = np.empty((count, channels), np.int64)
    for m in range(count):
        j = neighbours[m, 0]
        for c in range(channels):
            largest[m, c] = rows[j, c]
            source[m, c] = j
        for e in range(1, k):
            j = neighbours[m, e]
            for c in range(channels):
                more = rows[j, c] > largest[m, c]
                largest[m, c] = rows[j, c] if more else largest[m, c]
                source[m, c] = j if more else source[m, c]
    return largest, source

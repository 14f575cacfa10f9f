"""Compiled transforms of single points and directions, for the kernels of all sub-packages."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
def apply(T: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the point ``T @ (x, y, z, 1)``."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@njit(cache=True, nogil=True)
def rotate(T: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the direction ``T[:3, :3] @ (x, y, z)``."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z,
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z,
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z,
    )

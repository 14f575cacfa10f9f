"""Compiled kernels of the structured-light sensor: the projector's shadow, losses beside steps, and noise.

Everything is in the camera frame, in metres. ``depth`` is (H, W) float32, 0 where there is nothing. ``normals`` is
(H, W, 3) float32, unit vectors towards the eye. No kernel uses fast maths or threads: same arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]


@njit(cache=True, nogil=True, error_model="numpy")
def _shadow_row(depth: Singles, focal: float, baseline: float, shadow: Bools) -> None:
    """Set (W,) ``shadow`` where a row's pixels are not reached by the projector; see `projector_shadow`."""
    width = len(depth)
    sign = 1.0 if baseline > 0.0 else -1.0
    reached = np.inf
    for i in range(width):
        u = width - 1 - i if baseline > 0.0 else i
        if depth[u] <= 0:
            continue
        column = sign * (u - focal * baseline / depth[u])
        if column >= reached:
            shadow[u] = True
        else:
            reached = column


@njit(cache=True, nogil=True, error_model="numpy")
def projector_shadow(depth: Singles, K: Floats, baseline: float) -> Bools:
    """Return the (H, W) bool mask of pixels that a projector at camera x = ``baseline`` [m] does not reach.

    Camera and projector are a rectified pair, so light travels along image rows: pixel u is lit from projector column
    ``u - fx * baseline / z``. Away from the projector, the columns of lit surfaces only increase along a row: a
    surface whose column has been passed lies behind another. Bodies are assumed to reach down to what they stand on.
    """
    shadow = np.zeros(depth.shape, np.bool_)
    for v in range(len(depth)):
        _shadow_row(depth[v], K[0, 0], baseline, shadow[v])
    return shadow


@njit(cache=True, nogil=True, error_model="numpy")
def _is_step(depth: Singles, normals: Singles, K: Floats, v: int, u: int, w: int, s: int, jump: float) -> bool:
    """Tell whether (w, s), a neighbour of (v, u), has no depth or lies off both its depth and its tangent plane."""
    z, beside = depth[v, u], depth[w, s]
    if beside <= 0.0:
        return True
    if abs(beside - z) <= jump:
        return False
    nx, ny = normals[v, u, 0] / K[0, 0], normals[v, u, 1] / K[1, 1]
    here = nx * (u - K[0, 2]) + ny * (v - K[1, 2]) + normals[v, u, 2]
    there = nx * (s - K[0, 2]) + ny * (w - K[1, 2]) + normals[v, u, 2]
    return bool(there == 0.0 or abs(z * here / there - beside) > jump)


@njit(cache=True, nogil=True, error_model="numpy")
def _is_beside_step(depth: Singles, normals: Singles, K: Floats, v: int, u: int, jump: float) -> bool:
    """Tell whether there is a depth discontinuity between a measured pixel and one of its four neighbours."""
    height, width = depth.shape
    return bool(
        (u + 1 < width and _is_step(depth, normals, K, v, u, v, u + 1, jump))
        or (u > 0 and _is_step(depth, normals, K, v, u, v, u - 1, jump))
        or (v + 1 < height and _is_step(depth, normals, K, v, u, v + 1, u, jump))
        or (v > 0 and _is_step(depth, normals, K, v, u, v - 1, u, jump))
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _toward_row(normals: Singles, x: Floats, y: float, toward: Floats) -> None:
    """Fill a row of (W,) scalar products of the (W, 3) normals and the rays to the eye ``(-x, -y, -1)``."""
    for u in range(len(toward)):
        toward[u] = -(normals[u, 0] * x[u] + normals[u, 1] * y + normals[u, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def _measure_row(
    depth: Singles,
    toward: Floats,
    lost: Bools,
    x: Floats,
    y: float,
    noise: Singles,
    sigma: float,
    reference: float,
    min_cosine: float,
    measured: Singles,
) -> None:
    """Fill a row of (W,) measured depths: noise where the surface is not lost and not too steep, else 0."""
    for u in range(len(depth)):
        z = np.float64(depth[u])
        cosine = toward[u] / np.sqrt(x[u] * x[u] + y * y + 1.0)
        noisy = z + noise[u] * sigma * (z / reference) * (z / reference) / cosine
        seen = (z > 0.0) & (not lost[u]) & (cosine >= min_cosine)
        measured[u] = noisy if seen else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def measure_rows(
    depth: Singles,
    normals: Singles,
    K: Floats,
    noise: Singles,
    chance: Singles,
    first: int,
    sigma: float,
    reference: float,
    edge_loss: float,
    edge_jump: float,
    min_cosine: float,
    baseline: float,
    measured: Singles,
) -> None:
    """Fill R rows of the measured depth [m], 0 where nothing is measured; see ``sensor.SensorModel``.

    Args:
        depth: (H, W) float32 true depth [m].
        normals: (H, W, 3) float32 unit normals.
        K: (3, 3) pinhole matrix [px].
        noise: (H, W) float32 draws from the standard normal distribution.
        chance: (R, W) float32 draws from the uniform distribution in [0, 1).
        first: First of the rows that are filled.
        sigma: Standard deviation at the reference depth on a surface square to the ray [m].
        reference: Depth at which ``sigma`` holds [m].
        edge_loss: Share of the pixels beside depth discontinuities that are lost.
        edge_jump: Smallest depth step, beyond what the surface's slope explains, that is a discontinuity [m].
        min_cosine: Smallest cosine of the angle of incidence at which something is measured.
        baseline: Position of the projector along the camera's x axis [m]; 0 casts no shadow.
        measured: (H, W) float32; changed in place.
    """
    width = depth.shape[1]
    lost = np.empty(width, np.bool_)
    share = np.float32(edge_loss)
    x, toward = np.empty(width), np.empty(width)
    for u in range(width):
        x[u] = (u - K[0, 2]) / K[0, 0]
    for i in range(len(chance)):
        v = first + i
        lost[:] = False
        if baseline != 0.0:
            _shadow_row(depth[v], K[0, 0], baseline, lost)
        # Few pixels draw a loss, so whether there is a step beside them is looked at for these alone.
        for u in range(width):
            if chance[i, u] < share and depth[v, u] > 0.0 and _is_beside_step(depth, normals, K, v, u, edge_jump):
                lost[u] = True
        y = (v - K[1, 2]) / K[1, 1]
        _toward_row(normals[v], x, y, toward)
        _measure_row(depth[v], toward, lost, x, y, noise[v], sigma, reference, min_cosine, measured[v])

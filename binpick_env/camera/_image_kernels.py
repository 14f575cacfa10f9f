"""Compiled kernels over a depth image: shading it grey, and what a structured-light sensor does not measure.

Camera frame, metres; ``depth`` is (H, W) with 0 for nothing, ``normals`` (H, W, 3) float32 are unit, towards the eye.
No kernel uses fast maths or threads: same arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]


DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # (dv, du), all around


@njit(cache=True, nogil=True)
def _darkness(
    depth: Singles,
    normals: Singles,
    K: Floats,
    v: int,
    u: int,
    source_v: int,
    source_u: int,
    reach: float,
    floor: float,
    full: float,
) -> float:
    """Return in [0, 1] how much the surface at a source pixel darkens (v, u): by its height, fading with distance."""
    dv, du = np.float64(source_v - v), np.float64(source_u - u)
    distance = np.sqrt(dv * dv + du * du)
    if distance >= reach:
        return 0.0
    z, nearer = np.float64(depth[v, u]), np.float64(depth[source_v, source_u])
    dx = (nearer * (source_u - K[0, 2]) - z * (u - K[0, 2])) / K[0, 0]
    dy = (nearer * (source_v - K[1, 2]) - z * (v - K[1, 2])) / K[1, 1]
    above = normals[v, u, 0] * dx + normals[v, u, 1] * dy + normals[v, u, 2] * (nearer - z)
    return float(min(max((above - floor) / full, 0.0), 1.0) * (1.0 - distance / reach))


@njit(cache=True, nogil=True)
def _sweep(
    depth: Singles,
    normals: Singles,
    K: Floats,
    dv: int,
    du: int,
    radius: float,
    floor: float,
    full: float,
    hidden: Singles,
) -> None:
    """Carry edges along (dv, du) over the image; adds an eighth of their darkness to ``hidden`` in place."""
    height, width = depth.shape
    # The pixel that each column's latest pixel is darkened by, -1 for none: of the row before, and of this row.
    before_v, before_u = np.full(width, -1, np.int32), np.full(width, -1, np.int32)
    now_v, now_u = np.full(width, -1, np.int32), np.full(width, -1, np.int32)
    for i in range(height):
        v = height - 1 - i if dv < 0 else i
        pv = v - dv
        if pv < 0 or pv >= height:
            continue
        for j in range(width):
            u = width - 1 - j if du < 0 else j
            now_v[u] = -1
            pu = u - du
            if pu < 0 or pu >= width:
                continue
            z = depth[v, u]
            beside = 0.0 < depth[pv, pu] < z - floor
            source_v, source_u = (now_v[pu], now_u[pu]) if dv == 0 else (before_v[pu], before_u[pu])
            if z <= 0.0 or not (beside or source_v >= 0):
                continue
            reach = radius * K[0, 0] / z
            best = 0.0
            if source_v >= 0:
                best = _darkness(depth, normals, K, v, u, source_v, source_u, reach, floor, full)
            if beside:
                other = _darkness(depth, normals, K, v, u, pv, pu, reach, floor, full)
                if other > best:
                    best, source_v, source_u = other, pv, pu
            if best > 0.0:
                now_v[u], now_u[u] = source_v, source_u
                hidden[v, u] += 0.125 * best
        if dv != 0:
            before_v, now_v = now_v, before_v
            before_u, now_u = now_u, before_u


@njit(cache=True, nogil=True)
def ambient_occlusion(depth: Singles, normals: Singles, K: Floats, radius: float, floor: float, full: float) -> Singles:
    """Return (H, W) float32 in [0, 1]: the mean darkness that eight sweeps over the image cast on each pixel.

    A sweep carries along the last edge it fell over; what lies below is dark beside the edge and fades over ``radius``.

    Args:
        depth: (H, W) float32.
        normals: (H, W, 3) float32.
        K: (3, 3).
        radius: Reach of the darkness [m].
        floor: Height above the tangent plane that does not count yet [m]; keeps facets out.
        full: Height above ``floor`` that counts in full [m].
    """
    hidden = np.zeros(depth.shape, np.float32)
    for direction in DIRECTIONS:
        _sweep(depth, normals, K, direction[0], direction[1], radius, floor, full, hidden)
    return hidden


@njit(cache=True, nogil=True)
def shade(
    depth: Singles,
    normals: Singles,
    albedo: Singles,
    hidden: Singles,
    to_light: Floats,
    ambient: float,
    diffuse: float,
    falloff: float,
    reference: float,
    occlusion: float,
    background: int,
) -> Bytes:
    """Return the (H, W) uint8 image of a Lambertian scene; see ``shading.Light`` for the model.

    Args:
        depth: (H, W) float32.
        normals: (H, W, 3) float32.
        albedo: (H, W) float32 in [0, 1].
        hidden: (H, W) float32 in [0, 1].
        to_light: (3,) unit.
        ambient: Share of light from everywhere.
        diffuse: Share of light from ``to_light``.
        falloff: 0 for none, 1 for the inverse square of depth.
        reference: Depth at which the falloff is 1 [m].
        occlusion: How much darker a fully hidden point is, 0 to 1.
        background: Grey where there is no depth.
    """
    height, width = depth.shape
    grey = np.empty((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            z = np.float64(depth[v, u])
            if z <= 0.0:
                grey[v, u] = background
                continue
            n = normals[v, u]
            facing = n[0] * to_light[0] + n[1] * to_light[1] + n[2] * to_light[2]
            light = (ambient + diffuse * max(facing, 0.0)) * (1.0 - occlusion * hidden[v, u])
            light *= 1.0 + falloff * ((reference / z) * (reference / z) - 1.0)
            grey[v, u] = np.uint8(min(max(255.0 * albedo[v, u] * light + 0.5, 0.0), 255.0))
    return grey


@njit(cache=True, nogil=True)
def projector_shadow(depth: Singles, K: Floats, baseline: float) -> Bools:
    """Return the (H, W) bool mask of pixels that a projector at camera x = ``baseline`` [m] does not reach.

    Camera and projector are a rectified pair, so light travels along image rows: pixel u is lit from projector column
    ``u - fx * baseline / z``. Going away from the projector, the columns of lit surfaces only move on; a surface whose
    column has been passed lies behind something. Bodies are assumed to reach down to what they stand on.
    """
    height, width = depth.shape
    shadow = np.zeros((height, width), np.bool_)
    sign = 1.0 if baseline > 0.0 else -1.0
    for v in range(height):
        reached = np.inf
        for i in range(width):
            u = width - 1 - i if baseline > 0.0 else i
            if depth[v, u] <= 0:
                continue
            column = sign * (u - K[0, 0] * baseline / depth[v, u])
            if column >= reached:
                shadow[v, u] = True
            else:
                reached = column
    return shadow


@njit(cache=True, nogil=True)
def _is_step(depth: Singles, normals: Singles, K: Floats, v: int, u: int, w: int, s: int, jump: float) -> bool:
    """Tell whether the neighbour (w, s) of (v, u) is missing, or more than ``jump`` off its depth and its plane."""
    z, beside = depth[v, u], depth[w, s]
    if beside <= 0.0:
        return True
    if abs(beside - z) <= jump:
        return False
    nx, ny = normals[v, u, 0] / K[0, 0], normals[v, u, 1] / K[1, 1]
    here = nx * (u - K[0, 2]) + ny * (v - K[1, 2]) + normals[v, u, 2]
    there = nx * (s - K[0, 2]) + ny * (w - K[1, 2]) + normals[v, u, 2]
    return bool(there == 0.0 or abs(z * here / there - beside) > jump)


@njit(cache=True, nogil=True)
def beside_steps(depth: Singles, normals: Singles, K: Floats, jump: float) -> Bools:
    """Return the (H, W) bool mask of measured pixels with a depth discontinuity to one of their four neighbours."""
    height, width = depth.shape
    mask = np.zeros((height, width), np.bool_)
    for v in range(height):
        for u in range(width):
            if depth[v, u] > 0.0:
                mask[v, u] = (
                    (u + 1 < width and _is_step(depth, normals, K, v, u, v, u + 1, jump))
                    or (u > 0 and _is_step(depth, normals, K, v, u, v, u - 1, jump))
                    or (v + 1 < height and _is_step(depth, normals, K, v, u, v + 1, u, jump))
                    or (v > 0 and _is_step(depth, normals, K, v, u, v - 1, u, jump))
                )
    return mask


@njit(cache=True, nogil=True)
def measure(
    depth: Singles,
    normals: Singles,
    lost: Bools,
    K: Floats,
    noise: Singles,
    sigma: float,
    reference: float,
    min_cosine: float,
) -> Singles:
    """Return the (H, W) float32 depth with noise, and 0 where ``lost`` or seen at too flat an angle.

    The standard deviation is ``sigma * (z / reference)**2 / cos(incidence)``; ``noise`` (H, W) float32 is unit normal.
    """
    height, width = depth.shape
    measured = np.zeros((height, width), np.float32)
    for v in range(height):
        y = (v - K[1, 2]) / K[1, 1]
        for u in range(width):
            z = np.float64(depth[v, u])
            if z <= 0.0 or lost[v, u]:
                continue
            x = (u - K[0, 2]) / K[0, 0]
            toward = -(normals[v, u, 0] * x + normals[v, u, 1] * y + normals[v, u, 2])
            cosine = toward / np.sqrt(x * x + y * y + 1.0)
            if cosine < min_cosine:
                continue
            measured[v, u] = z + noise[v, u] * sigma * (z / reference) * (z / reference) / cosine
    return measured

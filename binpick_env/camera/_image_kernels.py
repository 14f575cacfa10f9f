"""Compiled kernels over a depth image: shading, and the losses and noise of a structured-light sensor.

Everything is in the camera frame, in metres. ``depth`` is (H, W) float32, 0 where there is nothing. ``normals`` is
(H, W, 3) float32, unit vectors towards the eye. No kernel uses fast maths or threads: same arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]


DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # the eight sweeps' (dv, du)


@njit(cache=True, nogil=True)
def _occlusion(
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
    """Return the occlusion in [0, 1] of pixel (v, u) by the surface at a source pixel.

    It grows with the height of the source above the pixel's tangent plane, and fades with their distance in the image.
    """
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
    occluded: Singles,
) -> None:
    """Sweep along (dv, du) over the image and add an eighth of the occlusion found to ``occluded`` in place.

    Each pixel inherits the occluding pixel of the one before it, and replaces it by that neighbour where it is nearer
    and occludes more.
    """
    height, width = depth.shape
    # Occluding pixel of each column, -1 for none, in the row before and in this row.
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
            # Candidates: the neighbour itself if it stands higher, and the pixel that occludes the neighbour.
            z = depth[v, u]
            beside = 0.0 < depth[pv, pu] < z - floor
            source_v, source_u = (now_v[pu], now_u[pu]) if dv == 0 else (before_v[pu], before_u[pu])
            if z <= 0.0 or not (beside or source_v >= 0):
                continue
            # The one that occludes more is kept, and handed on to the next pixel.
            reach = radius * K[0, 0] / z
            best = 0.0
            if source_v >= 0:
                best = _occlusion(depth, normals, K, v, u, source_v, source_u, reach, floor, full)
            if beside:
                other = _occlusion(depth, normals, K, v, u, pv, pu, reach, floor, full)
                if other > best:
                    best, source_v, source_u = other, pv, pu
            if best > 0.0:
                now_v[u], now_u[u] = source_v, source_u
                occluded[v, u] += 0.125 * best
        if dv != 0:
            before_v, now_v = now_v, before_v
            before_u, now_u = now_u, before_u


@njit(cache=True, nogil=True)
def ambient_occlusion(depth: Singles, normals: Singles, K: Floats, radius: float, floor: float, full: float) -> Singles:
    """Return the (H, W) float32 ambient occlusion in [0, 1]: the mean over eight sweeps in different directions.

    Each sweep carries the last depth edge along. Pixels below the edge are occluded, less with distance from it.

    Args:
        depth: (H, W) float32 depth [m].
        normals: (H, W, 3) float32 unit normals.
        K: (3, 3) pinhole matrix [px].
        radius: Distance over which the occlusion by an edge fades to nothing [m].
        floor: Height above the tangent plane up to which nothing is occluded [m]; leaves out facets.
        full: Height above ``floor`` from which occlusion is complete [m].
    """
    occluded = np.zeros(depth.shape, np.float32)
    for direction in DIRECTIONS:
        _sweep(depth, normals, K, direction[0], direction[1], radius, floor, full, occluded)
    return occluded


@njit(cache=True, nogil=True)
def shade(
    depth: Singles,
    normals: Singles,
    albedo: Singles,
    occluded: Singles,
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
        depth: (H, W) float32 depth [m].
        normals: (H, W, 3) float32 unit normals.
        albedo: (H, W) float32 albedo in [0, 1].
        occluded: (H, W) float32 ambient occlusion in [0, 1].
        to_light: (3,) unit vector to the lamp.
        ambient: Intensity of the light from everywhere.
        diffuse: Intensity of the light from the lamp.
        falloff: Decrease of intensity with depth: 0 for none, 1 for the inverse square.
        reference: Depth at which the falloff leaves the intensity as it is [m].
        occlusion: Share of light that a fully occluded point loses, 0 to 1.
        background: Grey value where there is no depth.
    """
    height, width = depth.shape
    grey = np.empty((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            z = np.float64(depth[v, u])
            if z <= 0.0:
                grey[v, u] = background
                continue
            # Lambert's cosine, less ambient occlusion, times the falloff with depth; rounded to 8 bits.
            n = normals[v, u]
            facing = n[0] * to_light[0] + n[1] * to_light[1] + n[2] * to_light[2]
            light = (ambient + diffuse * max(facing, 0.0)) * (1.0 - occlusion * occluded[v, u])
            light *= 1.0 + falloff * ((reference / z) * (reference / z) - 1.0)
            grey[v, u] = np.uint8(min(max(255.0 * albedo[v, u] * light + 0.5, 0.0), 255.0))
    return grey


@njit(cache=True, nogil=True)
def owners_of_depth(
    depth: Singles, depth_true: Singles, instance_ids: NDArray[np.int64], off: float, reach: int
) -> NDArray[np.int64]:
    """Return the (H, W) int64 part whose surface each measured depth belongs to, -1 for none.

    It is the part at the pixel if the depth there fits, or else the part at the nearest pixel whose depth fits, and
    none where no pixel's does, as for flying pixels between two surfaces.

    Args:
        depth: (H, W) float32 measured depth [m], 0 where nothing is measured.
        depth_true: (H, W) float32 true depth [m].
        instance_ids: (H, W) part seen by each pixel, -1 for none.
        off: Largest difference of depths that fit [m].
        reach: Largest distance of the other pixel along rows and columns [px].
    """
    height, width = depth.shape
    owners = np.full((height, width), -1, np.int64)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if z <= 0.0:
                continue
            if abs(z - depth_true[v, u]) <= off:
                owners[v, u] = instance_ids[v, u]
                continue
            nearest = 2 * reach * reach + 1
            for dv in range(-reach, reach + 1):
                for du in range(-reach, reach + 1):
                    w, s = v + dv, u + du
                    squared = dv * dv + du * du
                    if squared >= nearest or w < 0 or s < 0 or w >= height or s >= width:
                        continue
                    if depth_true[w, s] > 0.0 and abs(z - depth_true[w, s]) <= off:
                        nearest, owners[v, u] = squared, instance_ids[w, s]
    return owners


@njit(cache=True, nogil=True)
def projector_shadow(depth: Singles, K: Floats, baseline: float) -> Bools:
    """Return the (H, W) bool mask of pixels that a projector at camera x = ``baseline`` [m] does not reach.

    Camera and projector are a rectified pair, so light travels along image rows: pixel u is lit from projector column
    ``u - fx * baseline / z``. Away from the projector, the columns of lit surfaces only increase along a row: a
    surface whose column has been passed lies behind another. Bodies are assumed to reach down to what they stand on.
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
    """Return the measured (H, W) float32 depth [m], 0 where nothing is measured.

    The standard deviation of the noise is ``sigma * (z / reference)**2 / cos(incidence)``.

    Args:
        depth: (H, W) float32 true depth [m].
        normals: (H, W, 3) float32 unit normals.
        lost: (H, W) mask of pixels without a measurement.
        K: (3, 3) pinhole matrix [px].
        noise: (H, W) float32 draws from the standard normal distribution.
        sigma: Standard deviation at the reference depth on a surface square to the ray [m].
        reference: Depth at which ``sigma`` holds [m].
        min_cosine: Smallest cosine of the angle of incidence at which something is measured.
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

"""Compiled kernels over a depth image: shading, and the owners of measured depths.

Everything is in the camera frame, in metres. ``depth`` is (H, W) float32, 0 where there is nothing. ``normals`` is
(H, W, 3) float32, unit vectors towards the eye. No kernel uses fast maths or threads: same arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import Floats

Singles = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def _facing_row(normals: Singles, to_light: Floats, facing: Floats) -> None:
    """Fill a row of (W,) cosines between the (W, 3) normals and the direction to the lamp."""
    x, y, z = to_light
    for u in range(len(facing)):
        facing[u] = normals[u, 0] * x + normals[u, 1] * y + normals[u, 2] * z


@njit(cache=True, nogil=True, error_model="numpy")
def _shade_row(
    depth: Singles,
    facing: Floats,
    albedo: Singles,
    occluded: Singles,
    ambient: float,
    diffuse: float,
    falloff: float,
    reference: float,
    occlusion: float,
    background: float,
    grey: Bytes,
) -> None:
    """Fill a row of (W,) grey values: Lambert's cosine, less ambient occlusion, times the falloff with depth."""
    for u in range(len(grey)):
        z = np.float64(depth[u])
        light = (ambient + diffuse * max(facing[u], 0.0)) * (1.0 - occlusion * occluded[u])
        light *= 1.0 + falloff * ((reference / z) * (reference / z) - 1.0)
        value = min(max(255.0 * albedo[u] * light + 0.5, 0.0), 255.0)
        grey[u] = np.uint8(np.int32(value if z > 0.0 else background))


@njit(cache=True, nogil=True, error_model="numpy")
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
    facing = np.empty(width)
    empty = np.float64(background)
    for v in range(height):
        _facing_row(normals[v], to_light, facing)
        _shade_row(
            depth[v], facing, albedo[v], occluded[v], ambient, diffuse, falloff, reference, occlusion, empty, grey[v]
        )
    return grey


@njit(cache=True, nogil=True, error_model="numpy")
def instances_at(geom_at: Ints, instances: Longs) -> Longs:
    """Return the (H, W) int64 part that each pixel's geom belongs to, -1 for none.

    Args:
        geom_at: (H, W) int32 geom of the model, -1 where there is nothing.
        instances: (ngeom + 1,) part of each geom, -1 for none; the last entry stands for nothing.
    """
    ids = np.empty(geom_at.shape, np.int64)
    for v in range(len(geom_at)):
        for u in range(geom_at.shape[1]):
            geom = geom_at[v, u]
            ids[v, u] = instances[geom if geom >= 0 else len(instances) - 1]
    return ids


@njit(cache=True, nogil=True)
def owners_of_depth(depth: Singles, depth_true: Singles, instance_ids: Longs, off: float, reach: int) -> Longs:
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

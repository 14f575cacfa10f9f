"""Plain loops for ambient occlusion: eight sweeps over the whole image, pixel by pixel."""

import numpy as np

DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))


def ambient_occlusion(depth, normals, K, radius, floor, full):
    """Return the (H, W) float32 ambient occlusion; the arguments are those of the kernel."""
    z, n = depth.astype(np.float64), normals.astype(np.float64)
    occluded = np.zeros(depth.shape, np.float32)
    for dv, du in DIRECTIONS:
        _sweep(z, n, K, (dv, du), (radius, floor, full), occluded)
    return occluded


def _sweep(depth, normals, K, direction, sizes, occluded):
    dv, du = direction
    height, width = depth.shape
    source = {}  # occluding pixel of each pixel that has one
    for v in range(height)[:: -1 if dv < 0 else 1]:
        for u in range(width)[:: -1 if du < 0 else 1]:
            before = v - dv, u - du
            if not (0 <= before[0] < height and 0 <= before[1] < width) or depth[v, u] <= 0:
                continue
            best = 0.0
            if before in source:
                best = _occlusion(depth, normals, K, (v, u), source[before], sizes)
                if best > 0:
                    source[v, u] = source[before]
            if 0 < depth[before] < depth[v, u] - sizes[1]:
                beside = _occlusion(depth, normals, K, (v, u), before, sizes)
                if beside > best:
                    best, source[v, u] = beside, before
            occluded[v, u] = np.float32(occluded[v, u] + 0.125 * best)


def _occlusion(depth, normals, K, pixel, source, sizes):
    (v, u), (w, s), (radius, floor, full) = pixel, source, sizes
    z, near = depth[v, u], depth[w, s]
    reach = radius * K[0, 0] / z
    distance = np.sqrt(float((w - v) ** 2 + (s - u) ** 2))
    if distance >= reach:
        return 0.0
    dx = (near * (s - K[0, 2]) - z * (u - K[0, 2])) / K[0, 0]
    dy = (near * (w - K[1, 2]) - z * (v - K[1, 2])) / K[1, 1]
    above = normals[v, u, 0] * dx + normals[v, u, 1] * dy + normals[v, u, 2] * (near - z)
    return min(max((above - floor) / full, 0.0), 1.0) * (1.0 - distance / reach)

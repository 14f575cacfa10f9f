"""Compiled kernels of the camera: triangles to pixels, pixels to groups of rays.

Arrays in, arrays out; every position is in the camera frame (x right, y down, z forward) [m], and pixel ``(v, u)``
looks along ``((u - cx) / fx, (v - cy) / fy, 1)``, so that a distance along this ray is a depth. ``region`` is the
half-open rectangle ``(u0, v0, u1, v1)`` of pixels that may be touched. No kernel uses fast maths or threads: same
arrays, same bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.geometry import NEAR, Floats

Singles = NDArray[np.float32]
Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]


@njit(cache=True, nogil=True)
def place_vertices(vertices: Floats, vertex_geom: Longs, rotations: Floats, positions: Floats) -> Floats:
    """Map (V, 3) vertices from their geoms' frames by (G, 3, 3) and (G, 3) poses; returns (V, 3)."""
    placed = np.empty_like(vertices)
    for i in range(len(vertices)):
        R = rotations[vertex_geom[i]]
        t = positions[vertex_geom[i]]
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            placed[i, k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z + t[k]
    return placed


@njit(cache=True, nogil=True)
def _edge_planes(a: Floats, b: Floats, c: Floats, planes: Floats) -> None:
    """Fill (3, 3) with the planes through the eye and each edge; two triangles see a shared edge with exact opposites.

    ``planes[k] @ ray`` is proportional to the barycentric weight of corner k.
    """
    for k in range(3):
        p, q = (b, c) if k == 0 else ((c, a) if k == 1 else (a, b))
        planes[k, 0] = p[1] * q[2] - p[2] * q[1]
        planes[k, 1] = p[2] * q[0] - p[0] * q[2]
        planes[k, 2] = p[0] * q[1] - p[1] * q[0]


@njit(cache=True, nogil=True)
def _pixel_box(a: Floats, b: Floats, c: Floats, K: Floats, region: Longs) -> tuple[int, int, int, int]:
    """Return the rectangle (u0, v0, u1, v1) of pixels that a triangle can cover; it is empty behind the eye."""
    u0, v0, u1, v1 = region[0], region[1], region[2], region[3]
    if a[2] <= NEAR and b[2] <= NEAR and c[2] <= NEAR:
        return u0, v0, u0, v0
    if a[2] <= NEAR or b[2] <= NEAR or c[2] <= NEAR:
        return u0, v0, u1, v1
    xa, xb, xc = a[0] / a[2], b[0] / b[2], c[0] / c[2]
    ya, yb, yc = a[1] / a[2], b[1] / b[2], c[1] / c[2]
    # One pixel more on each side: rounding may not decide here what the edge planes decide exactly.
    low_u = max(np.float64(u0), np.floor(K[0, 0] * min(xa, xb, xc) + K[0, 2]))
    low_v = max(np.float64(v0), np.floor(K[1, 1] * min(ya, yb, yc) + K[1, 2]))
    high_u = min(np.float64(u1), np.ceil(K[0, 0] * max(xa, xb, xc) + K[0, 2]) + 1.0)
    high_v = min(np.float64(v1), np.ceil(K[1, 1] * max(ya, yb, yc) + K[1, 2]) + 1.0)
    if low_u >= high_u or low_v >= high_v:
        return u0, v0, u0, v0
    return int(low_u), int(low_v), int(high_u), int(high_v)


@njit(cache=True, nogil=True)
def _row_span(planes: Floats, sign: float, K: Floats, y: float, low: int, high: int) -> tuple[int, int]:
    """Return the half-open columns [low, high) of one row that can be inside; at most a pixel too wide at each end."""
    for k in range(3):
        slope = sign * planes[k, 0] / K[0, 0]
        rest = sign * (planes[k, 1] * y + planes[k, 2]) - slope * K[0, 2]
        if slope > 0.0:
            low = int(min(max(np.floor(-rest / slope), np.float64(low)), np.float64(high)))
        elif slope < 0.0:
            high = int(max(min(np.ceil(-rest / slope) + 1.0, np.float64(high)), np.float64(low)))
    return low, high


@njit(cache=True, nogil=True)
def rasterise(
    vertices: Floats,
    faces: Ints,
    face_range: Longs,
    two_sided: Bools,
    K: Floats,
    region: Longs,
    depth: Floats,
    face_at: Ints,
) -> None:
    """Draw triangles into a z-buffer: a pixel belongs to a triangle if its centre's ray meets it.

    Args:
        vertices: (V, 3) float64 vertices in the camera frame [m].
        faces: (T, 3) int32 vertices of each face.
        face_range: (M, 2) int64 half-open ranges of faces to draw.
        two_sided: (T,) mask of the faces that are drawn from both sides; others only from their counter-clockwise side.
        K: (3, 3) pinhole matrix [px].
        region: (4,) int64 rectangle of pixels to draw into.
        depth: (H, W) float64 z-buffer [m], infinite where empty; changed in place.
        face_at: (H, W) int32 face that owns each depth; changed in place.
    """
    planes = np.empty((3, 3))
    for m in range(len(face_range)):
        for t in range(face_range[m, 0], face_range[m, 1]):
            a, b, c = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
            u0, v0, u1, v1 = _pixel_box(a, b, c, K, region)
            if u0 >= u1 or v0 >= v1:
                continue
            _edge_planes(a, b, c, planes)
            # The sum of the edge planes is the triangle's normal, and the determinant its distance along it.
            n0 = planes[0, 0] + planes[1, 0] + planes[2, 0]
            n1 = planes[0, 1] + planes[1, 1] + planes[2, 1]
            n2 = planes[0, 2] + planes[1, 2] + planes[2, 2]
            offset = a[0] * planes[0, 0] + a[1] * planes[0, 1] + a[2] * planes[0, 2]
            if offset == 0.0 or (offset > 0.0 and not two_sided[t]):
                continue
            sign = 1.0 if offset > 0.0 else -1.0
            nearest, farthest = max(min(a[2], b[2], c[2]), NEAR), max(a[2], b[2], c[2])
            # Row by row: pixels inside all three edges, at the depth of the triangle's plane there.
            for v in range(v0, v1):
                y = (v - K[1, 2]) / K[1, 1]
                low, high = _row_span(planes, sign, K, y, u0, u1)
                for u in range(low, high):
                    x = (u - K[0, 2]) / K[0, 0]
                    e0 = sign * (planes[0, 0] * x + planes[0, 1] * y + planes[0, 2])
                    e1 = sign * (planes[1, 0] * x + planes[1, 1] * y + planes[1, 2])
                    e2 = sign * (planes[2, 0] * x + planes[2, 1] * y + planes[2, 2])
                    if e0 < 0.0 or e1 < 0.0 or e2 < 0.0:
                        continue
                    slant = n0 * x + n1 * y + n2
                    if slant == 0.0:
                        continue
                    z = min(max(offset / slant, nearest), farthest)
                    if z < depth[v, u]:
                        depth[v, u] = z
                        face_at[v, u] = t


@njit(cache=True, nogil=True)
def count_silhouettes(
    vertices: Floats, faces: Ints, rotations: Floats, positions: Floats, K: Floats, region: Longs, stamp: Ints
) -> Longs:
    """Return the (N,) number of pixels in the silhouette of one closed mesh at each of N poses, drawn alone.

    Args:
        vertices: (V, 3) float64 vertices in the part frame [m].
        faces: (T, 3) int32 vertices of each face.
        rotations: (N, 3, 3) float64 rotations from the part frame to the camera's.
        positions: (N, 3) float64 origins of the part frame in the camera frame [m].
        K: (3, 3) pinhole matrix [px].
        region: (4,) int64 rectangle of pixels that count.
        stamp: (H, W) int32 last pose that each pixel was counted for, filled with -1; changed in place.
    """
    counts = np.zeros(len(positions), np.int64)
    planes = np.empty((3, 3))
    owner = np.zeros(len(vertices), np.int64)
    for n in range(len(positions)):
        placed = place_vertices(vertices, owner, rotations[n : n + 1], positions[n : n + 1])
        for t in range(len(faces)):
            a, b, c = placed[faces[t, 0]], placed[faces[t, 1]], placed[faces[t, 2]]
            u0, v0, u1, v1 = _pixel_box(a, b, c, K, region)
            if u0 >= u1 or v0 >= v1:
                continue
            _edge_planes(a, b, c, planes)
            offset = a[0] * planes[0, 0] + a[1] * planes[0, 1] + a[2] * planes[0, 2]
            if offset >= 0.0:  # the front faces of a closed mesh cover its whole silhouette
                continue
            # Count each pixel once for this pose, whichever of its faces covers it.
            for v in range(v0, v1):
                y = (v - K[1, 2]) / K[1, 1]
                low, high = _row_span(planes, -1.0, K, y, u0, u1)
                for u in range(low, high):
                    if stamp[v, u] == n:
                        continue
                    x = (u - K[0, 2]) / K[0, 0]
                    e0 = planes[0, 0] * x + planes[0, 1] * y + planes[0, 2]
                    e1 = planes[1, 0] * x + planes[1, 1] * y + planes[1, 2]
                    e2 = planes[2, 0] * x + planes[2, 1] * y + planes[2, 2]
                    if e0 <= 0.0 and e1 <= 0.0 and e2 <= 0.0:
                        stamp[v, u] = n
                        counts[n] += 1
    return counts


@njit(cache=True, nogil=True)
def interpolate_normals(
    vertices: Floats,
    faces: Ints,
    corner_normals: Singles,
    face_geom: Ints,
    rotations: Floats,
    K: Floats,
    region: Longs,
    geom_at: Ints,
    face_at: Ints,
    normals: Singles,
) -> None:
    """Overwrite (H, W, 3) float32 ``normals`` in place where ``face_at`` belongs to the geom in ``geom_at``.

    ``corner_normals`` (T, 3, 3) float32 are in their geoms' frames, ``rotations`` (G, 3, 3) turn them to the camera's.
    """
    planes = np.empty((3, 3))
    for v in range(region[1], region[3]):
        y = (v - K[1, 2]) / K[1, 1]
        for u in range(region[0], region[2]):
            t = face_at[v, u]
            if t < 0 or face_geom[t] != geom_at[v, u]:
                continue
            x = (u - K[0, 2]) / K[0, 0]
            _edge_planes(vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]], planes)
            # Mean of the corners' normals, weighted by the barycentric coordinates of the pixel.
            n0 = n1 = n2 = 0.0
            side = 0.0
            for k in range(3):
                w = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
                n0 += w * corner_normals[t, k, 0]
                n1 += w * corner_normals[t, k, 1]
                n2 += w * corner_normals[t, k, 2]
                side += w
            # Turned to the camera frame and to unit length.
            R = rotations[geom_at[v, u]]
            m0 = R[0, 0] * n0 + R[0, 1] * n1 + R[0, 2] * n2
            m1 = R[1, 0] * n0 + R[1, 1] * n1 + R[1, 2] * n2
            m2 = R[2, 0] * n0 + R[2, 1] * n1 + R[2, 2] * n2
            # A face seen from its front has negative weights; one seen from behind has its normal turned to the eye.
            length = -np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
            if length < 0.0 and side != 0.0:
                normals[v, u, 0] = m0 / length
                normals[v, u, 1] = m1 / length
                normals[v, u, 2] = m2 / length


@njit(cache=True, nogil=True)
def split_groups(group_at: Ints, inside: Bytes, u0: int, v0: int, child: Ints, count: int) -> int:
    """Move the pixels under a mask from their groups to new ones: all pixels of one group to the same new group.

    Args:
        group_at: (H, W) int32 group of each pixel, -1 for none; changed in place.
        inside: (h, w) uint8 mask of the pixels to move.
        u0: Column of the mask's left edge in the image.
        v0: Row of the mask's top edge in the image.
        child: (capacity,) int32 filled with -1; receives the new group of each group that pixels were moved from.
        count: Number of groups so far.

    Returns:
        The new number of groups.
    """
    for v in range(inside.shape[0]):
        for u in range(inside.shape[1]):
            old = group_at[v0 + v, u0 + u]
            if inside[v, u] == 0 or old < 0:
                continue
            if child[old] < 0:
                child[old] = count
                count += 1
            group_at[v0 + v, u0 + u] = child[old]
    return count


@njit(cache=True, nogil=True)
def group_pixels(group_at: Ints, region: Longs, count: int) -> tuple[Longs, Longs]:
    """Sort the region's pixels by group (a counting sort).

    Returns:
        (P,) flat pixel indices, and the (count + 1,) index at which each group starts in them.
    """
    # Count each group's pixels; their running sum is where each group starts.
    start = np.zeros(count + 1, np.int64)
    width = group_at.shape[1]
    for v in range(region[1], region[3]):
        for u in range(region[0], region[2]):
            if group_at[v, u] >= 0:
                start[group_at[v, u] + 1] += 1
    for g in range(count):
        start[g + 1] += start[g]
    # Put each pixel to the next free place of its group.
    place = start[:-1].copy()
    pixels = np.empty(start[-1], np.int64)
    for v in range(region[1], region[3]):
        for u in range(region[0], region[2]):
            g = group_at[v, u]
            if g >= 0:
                pixels[place[g]] = v * width + u
                place[g] += 1
    return pixels, start


@njit(cache=True, nogil=True)
def pixel_rays(pixels: Longs, width: int, K: Floats) -> Floats:
    """Return the (3 N,) float64 rays with z = 1 through flat ``pixels`` (N,)."""
    rays = np.empty(3 * len(pixels))
    for i in range(len(pixels)):
        v = pixels[i] // width
        u = pixels[i] - v * width
        rays[3 * i] = (u - K[0, 2]) / K[0, 0]
        rays[3 * i + 1] = (v - K[1, 2]) / K[1, 1]
        rays[3 * i + 2] = 1.0
    return rays


@njit(cache=True, nogil=True)
def scatter_hits(
    pixels: Longs, hit_geom: Ints, hit_depth: Floats, hit_normal: Floats, depth: Floats, geom_at: Ints, normals: Singles
) -> None:
    """Write rays' results to their pixels in place: flat (H W,) ``depth`` and ``geom_at``, (H W, 3) ``normals``."""
    for i in range(len(pixels)):
        if hit_geom[i] < 0:
            continue
        p = pixels[i]
        depth[p] = hit_depth[i]
        geom_at[p] = hit_geom[i]
        for k in range(3):
            normals[p, k] = hit_normal[3 * i + k]

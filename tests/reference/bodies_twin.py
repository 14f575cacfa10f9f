"""How deep points lie in a body, triangle by triangle, and which samples are deep in a grid, corner by corner."""

import itertools
import math

import numpy as np
import trimesh


def samples_within(T, samples, inside, origin, cell, depth):
    """Return how many samples are deeper than ``depth`` by the eight grid points about each."""
    found = 0
    for sample in samples:
        place = (T[:3, :3] @ sample + T[:3, 3] - origin) / cell
        if not np.isfinite(place).all():
            continue
        first = [math.floor(p) for p in place]
        if any(i < 0 or i + 1 >= n for i, n in zip(first, inside.shape, strict=True)):
            continue
        value = 0.0
        for corner in itertools.product((0, 1), repeat=3):
            weight = 1.0
            for axis in range(3):
                part = place[axis] - first[axis]
                weight *= part if corner[axis] else 1 - part
            value += weight * inside[tuple(i + c for i, c in zip(first, corner, strict=True))]
        found += value > depth
    return found


def depths(mesh, points):
    """Return (N,) the distance of points to the surface, negative outside: inside, all triangles together wind once."""
    nearest, winding = np.full(len(points), np.inf), np.zeros(len(points))
    for triangle in np.asarray(mesh.triangles):
        closest = trimesh.triangles.closest_point(np.tile(triangle, (len(points), 1, 1)), points)
        nearest = np.minimum(nearest, np.linalg.norm(closest - points, axis=1))
        a, b, c = (corner - points for corner in triangle)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        volume = np.einsum("ni,ni->n", a, np.cross(b, c))
        flat = la * lb * lc
        for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb)):
            flat = flat + np.einsum("ni,ni->n", u, v) * w
        winding += 2 * np.arctan2(volume, flat)
    return np.where(winding > 2 * np.pi, nearest, -nearest)

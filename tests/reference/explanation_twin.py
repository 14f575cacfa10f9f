"""Which pose explains a boundary point: every pose, every point and every sample."""

import math

import numpy as np


def distance(point, samples, normals, sideways):
    """Return the least distance of a point from samples, less along their planes than off them."""
    off = ((point - samples) * normals).sum(axis=1)
    aside = np.linalg.norm(point - samples - off[:, None] * normals, axis=1)
    return np.hypot(off, sideways * aside).min(initial=math.inf)


def claimed_points(points_cam, poses, surface, config):
    """Return (N,) the pose of the nearest surface, or -1."""
    limit, rows, explained = config.distance * surface.d_max, [], set()
    for T in poses:
        visible = surface.visible(T)
        samples = surface.points[visible] @ T[:3, :3].T + T[:3, 3]
        normals = surface.normals[visible] @ T[:3, :3].T
        row = [distance(point, samples, normals, config.sideways) for point in points_cam]
        mine = {k for k, value in enumerate(row) if value <= limit}
        again = len(mine & explained) > config.overlap * len(mine)
        rows.append([math.inf] * len(row) if again else row)
        explained |= set() if again else mine
    claims = []
    for column in zip(*rows, strict=True):
        nearest = min(range(len(column)), key=lambda p: column[p])
        claims.append(nearest if column[nearest] <= limit else -1)
    return np.array([c if c >= 0 and claims.count(c) >= config.min_points else -1 for c in claims])

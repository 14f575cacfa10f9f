"""The edges of a view found the other way: draw depth and normals ray by ray, compare neighbouring pixels."""

from collections.abc import Iterator

import numpy as np
import trimesh

from perception.geometry import Floats


def image_edges(
    mesh: trimesh.Trimesh, eye: Floats, centre: Floats, diameter: float, size: int, crease: float, depth_jump: float
) -> Floats:
    """Return the (N, 3) surface points of the pixels on the near side of every edge, part frame.

    Two neighbouring pixels differ by background, by their normals, or by the depth of one under the other's plane.
    """
    forward = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(forward, [0.36, 0.48, 0.8])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    ticks = ((np.arange(size) + 0.5) / size - 0.5) * 1.1 * diameter
    targets = centre + ticks[None, :, None] * right + ticks[:, None, None] * down
    rays = (targets - eye).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    places, ray, face = mesh.ray.intersects_location(np.tile(eye, (len(rays), 1)), rays, multiple_hits=False)
    surface = {int(r): (place, mesh.face_normals[f]) for r, place, f in zip(ray, places, face, strict=True)}
    edges = []
    for a, b in _neighbours(size):
        if a not in surface or b not in surface:
            edges += [surface[k][0] for k in (a, b) if k in surface]
            continue
        (place_a, normal_a), (place_b, normal_b) = surface[a], surface[b]
        gap = min(abs((place_b - place_a) @ normal_a), abs((place_b - place_a) @ normal_b))
        depth_a, depth_b = (place_a - eye) @ forward, (place_b - eye) @ forward
        if normal_a @ normal_b < np.cos(crease) or (abs(depth_a - depth_b) > depth_jump and gap > depth_jump / 2):
            edges.append(place_a if depth_a <= depth_b else place_b)
    return np.array(edges)


def _neighbours(size: int) -> Iterator[tuple[int, int]]:
    for row in range(size):
        for column in range(size):
            if column + 1 < size:
                yield row * size + column, row * size + column + 1
            if row + 1 < size:
                yield row * size + column, (row + 1) * size + column


def unoccluded(mesh: trimesh.Trimesh, eye: Floats, points: Floats, slack: float) -> list[bool]:
    """Return for each point whether the first surface on the ray from ``eye`` is not nearer than it by ``slack``."""
    free = []
    for point in points:
        distance = float(np.linalg.norm(point - eye))
        hits, _, _ = mesh.ray.intersects_location(eye[None], ((point - eye) / distance)[None], multiple_hits=True)
        free.append(all(np.linalg.norm(hit - eye) > distance - slack for hit in hits))
    return free

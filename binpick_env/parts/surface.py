"""Distances from points to the surface of a mesh, and from a turned mesh to itself."""

from collections.abc import Callable
from functools import partial

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Floats

FEW, MANY = 8, 48  # number of nearest samples whose faces are measured, at first and where it matters
_closest_point: Callable[[Floats, Floats], Floats] = trimesh.triangles.closest_point  # untyped there


class SurfaceProbe:
    """Distances from points to a mesh's surface, prepared for many queries.

    Every face carries samples about ``d_max / 100`` apart. A point is measured exactly against the faces of its nearest
    samples. The result is never too small, and too large only where many thin faces are near. The largest distances are
    therefore measured again, against more faces, before anything is decided.
    """

    def __init__(self, mesh: trimesh.Trimesh, *, samples: int = 2000) -> None:
        """Prepare the search tree, and up to ``samples`` surface points and as many vertices to be turned; seeded."""
        rng = np.random.default_rng(0)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        spread = trimesh.sample.sample_surface(mesh, samples, seed=0)[0]
        self.points: Floats = np.concatenate([spread, rng.permutation(vertices)[:samples]])
        self.points = rng.permutation(self.points)
        self._triangles: Floats = np.asarray(mesh.triangles, dtype=np.float64)
        self._spacing = float(np.linalg.norm(mesh.extents)) / 100
        on_faces, self._face_of = _face_samples(self._triangles, self._spacing)
        self._tree = cKDTree(on_faces)

    def rough_distance(self, points: Floats) -> Floats:
        """Return the (N,) distances of (N, 3) points to the nearest sample [m]: upper bounds to the surface."""
        return np.asarray(self._tree.query(points)[0])

    def distance(self, points: Floats, *, neighbours: int = MANY) -> Floats:
        """Return the (N,) distances [m] of (N, 3) points to the faces of their nearest ``neighbours`` samples."""
        _, near = self._tree.query(points, k=range(1, min(neighbours, len(self._face_of)) + 1))
        faces = self._face_of[near.reshape(len(points), -1)]
        repeated = np.repeat(points, faces.shape[1], axis=0)
        closest = _closest_point(self._triangles[faces.ravel()], repeated)
        gaps: Floats = np.linalg.norm(closest - repeated, axis=1).reshape(faces.shape).min(axis=1)
        return gaps

    def turned(self, rotation: Floats, centre: Floats, *, stride: int = 1) -> Floats:
        """Return every ``stride``-th point turned about ``centre``, by the rotation and by its inverse.

        A point turned by the inverse is as far from the surface as the point itself from the turned surface. Together
        they give the distances in both directions.
        """
        arms = self.points[::stride] - centre
        return np.concatenate([arms @ rotation.T, arms @ rotation]) + centre

    def error(self, rotation: Floats, centre: Floats) -> float:
        """Return the two-sided Hausdorff distance [m] between the surface and itself turned about ``centre``."""
        points = self.turned(rotation, centre)
        few = self.distance(points, neighbours=FEW)
        order = np.argsort(-few)
        largest = 0.0
        for block in np.array_split(order, max(1, len(order) // 200)):
            # Never too small, so a distance below the largest so far need not be measured again.
            doubtful = block[few[block] > largest]
            if len(doubtful) == 0:
                break
            largest = max(largest, float(self.distance(points[doubtful]).max()))
        return largest

    def fits(self, rotation: Floats, centre: Floats, tolerance: float) -> bool:
        """Tell whether :meth:`error` is within ``tolerance``, mostly without computing it."""
        if self.rough_distance(self.turned(rotation, centre, stride=20)).max() > tolerance + 3 * self._spacing:
            return False
        points = self.turned(rotation, centre)
        for distance in (self.rough_distance, partial(self.distance, neighbours=FEW), self.distance):
            points = points[distance(points) > tolerance]
            if len(points) == 0:
                return True
        return False


def _face_samples(triangles: Floats, spacing: float) -> tuple[Floats, NDArray[np.int64]]:
    """Spread points over each of (F, 3, 3) triangles, at least one each; return them (M, 3) and their faces (M,)."""
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=-1)
    area = 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=-1)
    counts = np.ceil(area / spacing**2 + edges.max(axis=1) / spacing).astype(
        np.int64
    )  # thin ones fill along their length
    face = np.repeat(np.arange(len(triangles)), counts)
    k = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    # The R2 sequence (Roberts 2018), folded into the triangle: even in the plane and along every line.
    u, v = (0.5 + k * 0.7548776662466927) % 1.0, (0.5 + k * 0.5698402909980532) % 1.0
    outside = u + v > 1
    u, v = np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)
    a, b, c = np.moveaxis(triangles[face], 1, 0)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), face

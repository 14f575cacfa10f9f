"""Distances from points to the surface of a mesh, and from a turned mesh to itself."""

import numpy as np
import trimesh

from binpick_env.parts._triangle_kernels import build_tree, distances
from perception.geometry import Floats


class SurfaceProbe:
    """Exact distances from points to a mesh's surface, prepared for many queries."""

    def __init__(self, mesh: trimesh.Trimesh, *, samples: int = 2000) -> None:
        """Prepare the search tree, and up to ``samples`` surface points and as many vertices to be turned; seeded."""
        rng = np.random.default_rng(0)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        spread = trimesh.sample.sample_surface(mesh, samples, seed=0)[0]
        self.points: Floats = np.concatenate([spread, rng.permutation(vertices)[:samples]])
        self.points = rng.permutation(self.points)
        self._triangles: Floats = np.ascontiguousarray(mesh.triangles, dtype=np.float64)
        self._tree = build_tree(self._triangles)

    def distance(self, points: Floats) -> Floats:
        """Return the (N,) distances [m] of (N, 3) points to the surface."""
        return distances(np.ascontiguousarray(points, dtype=np.float64), self._triangles, *self._tree)

    def turned(self, rotation: Floats, centre: Floats, *, stride: int = 1) -> Floats:
        """Return every ``stride``-th point turned about ``centre``, by the rotation and by its inverse.

        A point turned by the inverse is as far from the surface as the point itself from the turned surface. Together
        they give the distances in both directions.
        """
        arms = self.points[::stride] - centre
        return np.concatenate([arms @ rotation.T, arms @ rotation]) + centre

    def error(self, rotation: Floats, centre: Floats) -> float:
        """Return the two-sided Hausdorff distance [m] between the surface and itself turned about ``centre``."""
        return float(self.distance(self.turned(rotation, centre)).max())

    def fits(self, rotation: Floats, centre: Floats, tolerance: float) -> bool:
        """Tell whether :meth:`error` is within ``tolerance``, mostly without computing it."""
        few = self.turned(rotation, centre, stride=20)
        return bool(self.distance(few).max() <= tolerance) and self.error(rotation, centre) <= tolerance


def hausdorff_distance(first: trimesh.Trimesh, second: trimesh.Trimesh, *, samples: int = 4000) -> float:
    """Return the largest distance [m] of either surface from the other, over all vertices and ``samples`` points."""
    there = farthest(first, SurfaceProbe(second, samples=1), samples=samples)
    return max(there, farthest(second, SurfaceProbe(first, samples=1), samples=samples))


def farthest(mesh: trimesh.Trimesh, other: SurfaceProbe, *, samples: int = 4000) -> float:
    """Return the largest distance [m] of a mesh's vertices and of ``samples`` of its points from another surface."""
    spread = trimesh.sample.sample_surface(mesh, samples, seed=0)[0]
    points = np.concatenate([np.asarray(mesh.vertices, np.float64), spread])
    return float(other.distance(points).max())

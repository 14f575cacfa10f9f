"""A mesh to make parts of, and the slow way to measure one."""

import numpy as np
import trimesh

creation = trimesh.creation


def ell() -> trimesh.Trimesh:
    """Return an L of 60 x 40 x 30 mm, legs of 10 mm: two convex pieces, no symmetry."""
    foot, wall = creation.box((0.06, 0.03, 0.01)), creation.box((0.01, 0.03, 0.04))
    foot.apply_translation((0.03, 0, 0.005))
    wall.apply_translation((0.005, 0, 0.02))
    return trimesh.boolean.union([foot, wall], engine="manifold")


def naive_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Return each point's distance to the nearest of all triangles."""
    triangles = np.asarray(mesh.triangles)
    closest = [trimesh.triangles.closest_point(triangles, np.tile(p, (len(triangles), 1))) for p in points]
    return np.array([np.linalg.norm(c - p, axis=1).min() for c, p in zip(closest, points, strict=True)])

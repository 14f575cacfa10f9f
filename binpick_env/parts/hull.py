"""Convex hulls of few vertices that keep the volume, and whether a mesh is as good as its hull."""

import logging

import numpy as np
import trimesh

from binpick_env.parts.surface import SurfaceProbe, hausdorff_distance
from perception.geometry import Floats

log = logging.getLogger(__name__)
_DENT = 0.002  # share of the largest extent; depth of a dent up to which a mesh counts as convex
_MISSING = 0.002  # share of the hull's volume that such a mesh may lack


def is_nearly_convex(mesh: trimesh.Trimesh) -> bool:
    """Tell whether a mesh is its convex hull, but for dents of 0.2 % of its extent and of its volume."""
    hull = mesh.convex_hull
    if mesh.volume < (1 - _MISSING) * hull.volume:
        return False
    inner = np.asarray(mesh.vertices, np.float64)
    return bool(SurfaceProbe(hull, samples=1).distance(inner).max() <= _DENT * float(np.linalg.norm(mesh.extents)))


def thinned_hull(points: Floats, most: int) -> trimesh.Trimesh:
    """Return the convex hull of points, with at most ``most`` vertices and the hull's volume.

    The vertices farthest along even directions are kept, then those farthest outside of what is kept. The rest is
    enlarged about its centre to the volume of the whole hull. The largest deviation, outwards and inwards, is logged.

    Args:
        points: (N, 3) points, not all in one plane [m].
        most: Largest number of vertices, at least 8.
    """
    hull: trimesh.Trimesh = trimesh.convex.convex_hull(points)
    if len(hull.vertices) <= most:
        return hull
    corners = np.asarray(hull.vertices, np.float64)
    offsets = corners - hull.center_mass
    kept = np.unique(np.argmax(offsets @ _even_directions(most // 2).T, axis=0))
    thin: trimesh.Trimesh = trimesh.convex.convex_hull(corners[kept])
    while len(kept) < most:
        outside = (offsets @ thin.face_normals.T - _heights(thin, hull.center_mass)).max(axis=1)
        if outside.max() <= 0:
            break
        kept = np.append(kept, np.argmax(outside))
        thin = trimesh.convex.convex_hull(corners[kept])
    scale = (hull.volume / thin.volume) ** (1 / 3)
    thin.vertices = thin.center_mass + scale * (np.asarray(thin.vertices) - thin.center_mass)
    log.info(
        "a hull of %d vertices was thinned to %d; it deviates by at most %.2f mm",
        len(corners),
        len(thin.vertices),
        1e3 * hausdorff_distance(hull, thin, samples=1000),
    )
    return thin


def _heights(hull: trimesh.Trimesh, origin: Floats) -> Floats:
    """Return the (F,) distances of a hull's faces from a point inside."""
    heights: Floats = np.einsum("fi,fi->f", hull.triangles[:, 0] - origin, hull.face_normals)
    return heights


def _even_directions(count: int) -> Floats:
    """Return (N, 3) unit directions spread evenly: a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)

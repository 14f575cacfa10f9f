"""Convex hulls of few vertices that keep the volume, and whether a mesh is as good as its hull."""

import logging
from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError
from trimesh.convex import QHULL_DEFAULT

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
    while len(kept) < most:
        normals, places = _planes(corners[kept])
        outside = (offsets @ normals.T - _heights(normals, places, hull.center_mass)).max(axis=1)
        if outside.max() <= 0:
            break
        kept = np.append(kept, np.argmax(outside))
    thin: trimesh.Trimesh = trimesh.convex.convex_hull(corners[kept])
    scale = (hull.volume / thin.volume) ** (1 / 3)
    thin.vertices = thin.center_mass + scale * (np.asarray(thin.vertices) - thin.center_mass)
    log.info(
        "a hull of %d vertices was thinned to %d; it deviates by at most %.2f mm",
        len(corners),
        len(thin.vertices),
        1e3 * hausdorff_distance(hull, thin, samples=1000),
    )
    return thin


def distance_outside(points: Floats, hulls: Sequence[Floats]) -> float:
    """Return how far the worst of (N, 3) points lies beyond the planes of the hull that is nearest to it [m].

    Args:
        points: (N, 3) points [m].
        hulls: (V, 3) vertices of each hull; flat ones are ignored.

    Returns:
        The distance, 0 if every point lies in a hull, and infinity if there is no hull.
    """
    beyond = np.full(len(points), np.inf)
    for vertices in hulls:
        try:
            planes = ConvexHull(vertices).equations
        except (QhullError, ValueError):  # flat, or too few points
            continue
        beyond = np.minimum(beyond, (points @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return max(0.0, float(beyond.max()))


def _planes(points: Floats) -> tuple[Floats, Floats]:
    """Return the (F, 3) normals and (F, 3) first corners of the faces of trimesh's convex hull of points, bit by bit.

    That hull's class, its merging of vertices and its checks take ten times as long as the hull itself.
    """
    found = ConvexHull(points, qhull_options=str(QHULL_DEFAULT))
    order = np.sort(found.vertices)
    places = np.zeros(len(points), np.int64)
    places[order] = np.arange(len(order))
    vertices, faces = found.points[order], places[found.simplices]
    crosses = trimesh.triangles.cross(vertices[faces])
    normals, valid = trimesh.util.unitize(crosses, check_valid=True)
    faces, crosses = faces[valid], crosses[valid]
    middles = vertices[faces].mean(axis=1)
    centre = np.average(middles, weights=np.linalg.norm(crosses, axis=1), axis=0)
    backwards = trimesh.util.diagonal_dot(normals, middles - centre) < 0
    faces[backwards] = np.fliplr(faces[backwards])
    normals[backwards] *= -1.0
    edges = faces.ravel() * len(vertices) + np.roll(faces, -1, axis=1).ravel()
    if len(np.unique(edges)) < len(edges) or not valid.all():  # slivers, which trimesh turns
        hull = trimesh.convex.convex_hull(points)
        return np.asarray(hull.face_normals), np.asarray(hull.triangles[:, 0])
    return normals, vertices[faces[:, 0]]


def _heights(normals: Floats, places: Floats, origin: Floats) -> Floats:
    """Return the (F,) distances from a point inside to planes with (F, 3) normals through (F, 3) places."""
    heights: Floats = np.einsum("fi,fi->f", places - origin, normals)
    return heights


def _even_directions(count: int) -> Floats:
    """Return (N, 3) unit directions spread evenly: a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)

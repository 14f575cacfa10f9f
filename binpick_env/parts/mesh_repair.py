"""Repair of meshes that are not closed: coincident vertices, internal faces, holes; and what it moved."""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from binpick_env.parts.mesh_edges import separated
from binpick_env.parts.solids import triangulate
from perception.geometry import Floats
from perception.winding import shells_of

log = logging.getLogger(__name__)
_MERGING = (1e-7, 1e-6, 1e-5, 1e-4)  # distances within which vertices are merged, one after the other [extent]
_FLAT = 0.005  # share of the extent; a hole whose border deviates less from a plane is closed, however wide it is
_SMALL = 0.1  # share of the extent; a hole that is narrower is closed, whatever its border
_NEAR, _SHORTER = (
    0.1,
    0.1,
)  # distance of corners that may be one, as a share of this quantile of the open edges' lengths
_SHEET = 1e-6  # share of area times extent; a surface that encloses less has no volume


def closed(mesh: trimesh.Trimesh, path: Path) -> trimesh.Trimesh:
    """Return a closed mesh: the same one if it is closed already, or else a repaired copy.

    Vertices within growing distances are merged, at first equal ones and at last those within 0.01 % of the extent.
    Faces that lie on each other are removed, and bodies that touch in edges or faces are taken apart. Flat holes and
    small ones are closed. A line of the log says how far vertices were moved and how wide the holes were.

    Args:
        mesh: Mesh as read.
        path: File that the mesh was read from, which errors name.

    Raises:
        ValueError: The mesh stays open; the message counts the edges and says what to do.
    """
    if mesh.is_watertight:
        return mesh
    extent = float(np.linalg.norm(mesh.extents))
    original = _cleaned(mesh.copy())
    for tolerance in (0.0, *_MERGING):
        merged, moved = _merged(original, tolerance * extent) if tolerance else (original, 0.0)
        for candidate in _readings(merged):
            if candidate.is_watertight:
                if moved > 0:
                    log.warning("%s was not watertight; vertices were merged that lay up to %.3g apart", path, moved)
                return candidate
    # Merging did not suffice: fill the holes of the mesh whose rounding errors are gone, and of the coarser one else.
    for tolerance in (0.0, *_MERGING):
        merged, moved = _merged(original, tolerance * extent) if tolerance else (original, 0.0)
        merged, (width, length), count = _filled(_single_faced(merged), extent)
        if merged.is_watertight and not _has_sheet(merged, extent):
            log.warning(
                "%s was not watertight; holes up to %.3g wide and %.3g long were closed (%d), and vertices moved by up "
                "to %.3g",
                path,
                width,
                length,
                count,
                moved,
            )
            return merged
    repaired = _single_faced(original)
    counts = np.unique(repaired.edges_sorted, axis=0, return_counts=True)[1]
    lone, crowded = int(np.sum(counts == 1)), int(np.sum(counts > 2))
    near = _near_corners(repaired)
    apart = (
        ""
        if near is None
        else f"corners that should be one lie about {near:.2g} apart in the file's unit, and those up to "
        f"{_MERGING[-1] * extent:.2g} apart ({100 * _MERGING[-1]:g} % of the extent) are merged: export the part with "
        "more digits, or merge its close vertices, for instance in MeshLab; otherwise "
    )
    raise ValueError(
        f"the mesh of {path} must be watertight (every edge shared by two faces): after repair "
        f"{lone} of {len(counts)} edges are open and {crowded} are shared by three faces or more; {apart}export the "
        "part as a solid, or close it, for instance with MeshLab's screened Poisson reconstruction for scans"
    )


def _near_corners(mesh: trimesh.Trimesh) -> float | None:
    """Return how far the corners along open edges lie from the nearest ones that may be meant; None if none is near.

    They are near within a tenth of the shorter open edges' length: around a true hole, the nearest is one edge away.
    """
    edges, counts = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    lone = edges[counts == 1]
    if len(lone) == 0:
        return None
    vertices = np.asarray(mesh.vertices, np.float64)
    border = vertices[np.unique(lone)]
    distances, _ = cKDTree(border).query(border, [2])  # the first is the corner itself
    apart = float(np.median(distances))
    lengths = np.linalg.norm(np.diff(vertices[lone], axis=1)[:, 0], axis=1)
    return apart if apart <= _NEAR * float(np.quantile(lengths, _SHORTER)) else None


def _cleaned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def _readings(mesh: trimesh.Trimesh) -> Iterator[trimesh.Trimesh]:
    """Yield what faces that lie on each other, and edges that many faces share, may mean; the likeliest first."""
    yield _single_faced(mesh)
    touching = separated(_without_repeated_faces(mesh))
    if len(shells_of(touching)) > 1:  # bodies that touch each other
        yield touching
    yield _without_internal_faces(mesh)
    yield touching


def _single_faced(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh with one face of those that have the same three vertices, whatever their winding."""
    unique = mesh.unique_faces()
    return mesh if unique.all() else _of_faces(mesh, unique)


def _without_repeated_faces(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh with one face of those that have the same three vertices and the same winding."""
    faces = np.asarray(mesh.faces)
    turned = np.take_along_axis(faces, (np.argmin(faces, axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    kept = np.zeros(len(faces), np.bool_)
    kept[np.unique(turned, axis=0, return_index=True)[1]] = True
    return mesh if kept.all() else _of_faces(mesh, kept)


def _of_faces(mesh: trimesh.Trimesh, kept: NDArray[np.bool_]) -> trimesh.Trimesh:
    return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)[kept], process=False)


def _merged(mesh: trimesh.Trimesh, distance: float) -> tuple[trimesh.Trimesh, float]:
    """Return the mesh with all vertices within ``distance`` of each other merged, and how far one was moved."""
    vertices = np.asarray(mesh.vertices, np.float64)
    pairs = cKDTree(vertices).query_pairs(distance, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2)
    _, labels = connected_components(links, directed=False)
    first = np.unique(labels, return_index=True)[1]
    merged = trimesh.Trimesh(vertices[first], labels[np.asarray(mesh.faces)], process=False)
    moved = float(np.linalg.norm(vertices - vertices[first][labels], axis=1).max(initial=0.0))
    return _cleaned(merged), moved


def _without_internal_faces(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh without faces that have the same three vertices: bodies that touch there become one."""
    _, same, counts = np.unique(np.sort(mesh.faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    kept = counts[same.ravel()] == 1
    if kept.all() or not kept.any():
        return mesh
    return _of_faces(mesh, kept)


def _filled(mesh: trimesh.Trimesh, extent: float) -> tuple[trimesh.Trimesh, tuple[float, float], int]:
    """Return the mesh with its flat holes and small ones closed, their largest width and length, and their number."""
    loops = _loops(mesh)
    vertices, faces = np.asarray(mesh.vertices, np.float64), [np.asarray(mesh.faces)]
    added: list[Floats] = []
    flat: list[tuple[NDArray[np.int64], Floats]] = []
    widest, longest, count = 0.0, 0.0, 0
    for loop in loops:
        border = vertices[loop]
        centre = border.mean(axis=0)
        axes = np.linalg.svd(border - centre)[2]
        width, bend = float(np.ptp(border, axis=0).max()), float(np.abs((border - centre) @ axes[2]).max())
        if bend > _FLAT * extent and width > _SMALL * extent:
            continue
        if bend <= _FLAT * extent:
            flat.append(_turned_left(loop, (border - centre) @ axes[:2].T))
        else:
            ahead = np.roll(loop, -1)
            hub = np.full(len(loop), len(vertices) + len(added))
            added.append(centre)
            faces.append(np.stack([ahead, loop, hub], axis=1))
        widest, longest = max(widest, _narrow_side(border, axes)), max(longest, width)
        count += 1
    for (loop, _), triangles in zip(flat, triangulate([outline for _, outline in flat]), strict=True):
        faces.append(loop[triangles])
    filled = trimesh.Trimesh(np.vstack([vertices, *added]), np.concatenate(faces), process=False)
    return filled, (widest, longest), count


def _narrow_side(border: Floats, axes: Floats) -> float:
    """Return the width of a hole: that of its outline, or less if it is a slit, which may be bent.

    Args:
        border: (N, 3) vertices around the hole, in order.
        axes: (3, 3) principal axes of the border, the longest first.
    """
    around = np.roll(border, -1, axis=0) - border
    area = 0.5 * float(np.linalg.norm(np.cross(border - border[0], around).sum(axis=0)))
    length = float(np.linalg.norm(around, axis=1).sum())
    return min(float(np.ptp(border @ axes[1])), 4 * area / length)  # a circle's diameter, twice the width of a slit


def _has_sheet(mesh: trimesh.Trimesh, extent: float) -> bool:
    """Return whether a surface of a closed mesh encloses no volume, as a triangle does that was closed by itself."""
    shell = np.empty(len(mesh.faces), np.int64)
    for k, faces in enumerate(shells_of(mesh)):
        shell[faces] = k
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, np.float64) - mesh.bounds.mean(axis=0), 1, 0)
    volumes = np.bincount(shell, np.einsum("ti,ti->t", a, np.cross(b, c)) / 6)
    areas = np.bincount(shell, np.asarray(mesh.area_faces))
    return bool(np.any(np.abs(volumes) <= _SHEET * extent * areas))


def _turned_left(loop: NDArray[np.int64], outline: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return a loop against its direction, as the faces that fill it have, and its outline, which then turns left.

    Args:
        loop: (N,) vertices around the hole.
        outline: (N, 2) their coordinates in the plane of the hole.
    """
    x, y = outline.T
    turns_left = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 0
    if turns_left:  # the plane is seen from its other side
        outline = outline * (-1.0, 1.0)
    return loop[::-1], outline[::-1]


def _loops(mesh: trimesh.Trimesh) -> list[NDArray[np.int64]]:
    """Return the vertices around each hole, in the direction of the faces' own edges."""
    edges = np.asarray(mesh.edges)
    _, same, counts = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    border = edges[counts[same.ravel()] == 1]
    following = {int(a): int(b) for a, b in border}
    if len(following) != len(border):
        return []  # holes that meet in a vertex, or faces that disagree
    loops = []
    while following:
        start, vertex = following.popitem()
        loop = [start]
        while vertex != start and vertex in following:
            loop.append(vertex)
            vertex = following.pop(vertex)
        if vertex == start and len(loop) >= 3:
            loops.append(np.array(loop))
    return loops

"""Edges shared by four faces or more: surfaces that touch there get vertices of their own."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from perception.geometry import Floats
from perception.winding import signed_volume

_FLUSH = 1e-3  # angle below which two faces at an edge lie on each other [rad]; more than float32 corners are off by


def separated(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a copy in which surfaces that touch along edges or in vertices share none of them.

    At an edge of several surfaces, the two faces that bound the same wedge of material belong together. A file without
    bodies, such as STL, gives such edges wherever two bodies have two vertices in common.

    Args:
        mesh: Mesh with merged vertices and consistent winding.

    Returns:
        The copy. It is watertight unless a surface is open or its winding is inconsistent.
    """
    faces = np.asarray(mesh.faces, np.int64)
    if signed_volume(mesh) < 0:
        faces = faces[:, ::-1]
    vertices = np.asarray(mesh.vertices, np.float64)
    pairs = _paired_edges(vertices, faces)
    # Two corners are one vertex if an edge that ends there joins their faces.
    first, second = pairs.T
    first_end, second_end = (3 * (k // 3) + (k + 1) % 3 for k in (first, second))
    links = np.concatenate([np.stack([first, second_end], axis=1), np.stack([first_end, second], axis=1)])
    count = faces.size
    graph = coo_matrix((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    corners = connected_components(graph, directed=False)[1].astype(np.int64)
    kept = np.unique(corners, return_index=True)[1]
    return trimesh.Trimesh(vertices[faces.ravel()[kept]], corners.reshape(-1, 3), process=False)


def _paired_edges(vertices: Floats, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (P, 2) half-edges that belong together, each as the index of the corner that it starts from."""
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    forward = starts < ends
    keys = np.minimum(starts, ends) * len(vertices) + np.maximum(starts, ends)
    order = np.lexsort((~forward, keys))  # by edge, those along it first
    _, firsts, counts = np.unique(keys[order], return_index=True, return_counts=True)
    plain = firsts[counts == 2]
    pairs = [np.stack([order[plain], order[plain + 1]], axis=1)]
    pairs[0] = pairs[0][forward[pairs[0][:, 0]] & ~forward[pairs[0][:, 1]]]
    for start, count in zip(firsts[counts > 2], counts[counts > 2], strict=True):
        half_edges = order[start : start + count]
        along = forward[half_edges]
        if 2 * int(along.sum()) == count:
            pairs.append(_wedges(vertices, faces, half_edges[along], half_edges[~along]))
    return np.concatenate(pairs)


def _wedges(
    vertices: Floats, faces: NDArray[np.int64], along: NDArray[np.int64], against: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return (K, 2) pairs of (K,) half-edges along an edge and (K,) against it that bound the same material."""
    ends = vertices[faces.ravel()[[along[0], against[0]]]]
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])

    def across(half_edges: NDArray[np.int64]) -> Floats:
        apexes = vertices[faces[half_edges // 3, (half_edges + 2) % 3]] - ends[0]
        flat = apexes - np.outer(apexes @ direction, direction)
        unit: Floats = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
        return unit

    ours, theirs = across(along), across(against)
    inwards = -np.cross(direction, ours)  # into the material, at right angles to the face
    angles = np.arctan2(inwards @ theirs.T, ours @ theirs.T) % (2 * np.pi)
    angles[angles < _FLUSH] += 2 * np.pi  # a face that lies on this one bounds another material
    pairs = []
    for _ in along:
        one, other = np.unravel_index(int(np.argmin(angles)), angles.shape)
        pairs.append((along[one], against[other]))
        angles[one, :] = angles[:, other] = np.inf
    return np.array(pairs, np.int64)

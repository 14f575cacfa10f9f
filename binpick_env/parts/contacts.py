"""Which bodies hold each other: an edge or a point in common is no joint."""

from collections.abc import Sequence

import manifold3d
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

_WIDTH = 100.0  # gaps; narrower contacts are edges: two cubes enlarged by a gap overlap by two gaps along an edge


def groups_in_contact(solids: Sequence[manifold3d.Manifold], gap: float) -> int:
    """Return the number of groups of bodies that overlap or share some face.

    Args:
        solids: Bodies, each enlarged by ``gap``, so that those in contact overlap.
        gap: Distance by which they were enlarged, in the units of the solids.
    """
    boxes = np.array([solid.bounding_box() for solid in solids])
    low, high = boxes[:, :3], boxes[:, 3:]
    near = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2)
    pairs = [(i, j) for i, j in np.argwhere(np.triu(near, 1)).tolist() if _joined(solids[i], solids[j], gap)]
    first, second = np.array(pairs, np.int64).reshape(-1, 2).T
    links = coo_matrix((np.ones(len(pairs)), (first, second)), shape=(len(solids),) * 2)
    return int(connected_components(links, directed=False)[0])


def _joined(one: manifold3d.Manifold, other: manifold3d.Manifold, gap: float) -> bool:
    """Tell whether the overlap of two enlarged bodies, two gaps thick on a common face, is wide somewhere."""
    for overlap in (one ^ other).decompose():
        box = np.array(overlap.bounding_box())
        length = float(np.linalg.norm(box[3:] - box[:3]))
        if overlap.volume() / (2 * gap) > _WIDTH * gap * length:
            return True
    return False

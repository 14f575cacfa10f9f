"""Candidate groups for pose estimation: those whose number of boundary points is nearest to that of a whole part.

Source: section IV.C of the paper; P is the number of boundary points of an unoccluded part.
"""

from collections.abc import Sequence

import numpy as np

from perception.geometry import Floats
from perception.part import PartModel
from perception.pose.model.appearances import edge_appearances


def expected_points(part: PartModel, K: Floats, depth: float) -> int:
    """Return P, the number of boundary points of an unoccluded part, from its CAD edges; see `EdgeAppearances`.

    The light is not known, so every crease counts, also those that a camera would not see.

    Args:
        part: Part whose edges are counted; its mesh must enclose a volume.
        K: (3, 3) camera matrix [px].
        depth: Distance of the part from the camera [m].

    Raises:
        ValueError: ``depth`` is not positive, or the mesh does not enclose a volume.
    """
    return edge_appearances(part).expected_points(K, depth)


def nearest_groups(sizes: Sequence[int], expected: int, count: int = 3, tolerance: float = 0.10) -> list[int]:
    """Return the indices of the ``count`` groups whose numbers of points are nearest to P, the nearest first.

    Groups within (1 +- ``tolerance``) P are the paper's candidates. They come first, but the order by difference would
    put them first anyway. Of equal groups the lower index comes first. Fewer groups give fewer indices.

    Args:
        sizes: Number of boundary points of each group.
        expected: P, the number of boundary points of an unoccluded part.
        count: Number of groups to return; 3 to 5 in the paper.
        tolerance: Relative tolerance of P; 0.1 in the paper.

    Raises:
        ValueError: ``expected`` or ``count`` is not positive, or ``tolerance`` is negative.
    """
    if expected < 1 or count < 1:
        raise ValueError(f"expected and count must be at least 1, got {expected} and {count}")
    if not tolerance >= 0:
        raise ValueError(f"tolerance must be 0 or more, got {tolerance}")
    away = np.abs(np.asarray(sizes, dtype=np.float64) - expected)
    outside = away > tolerance * expected
    return [int(k) for k in np.lexsort((np.arange(len(away)), away, outside))[:count]]

"""Which groups go to pose estimation, as in the paper: those whose number of boundary points is that of a whole part.

Source: section IV.C of the paper; P is the number of boundary points of a part that nothing hides.
"""

from collections.abc import Sequence

import numpy as np

from perception.geometry import Floats
from perception.part import PartModel
from perception.pose.model.appearances import edge_appearances


def expected_points(part: PartModel, K: Floats, depth: float) -> int:
    """Return P for ``depth`` [m] and camera ``K`` (3, 3) by the part's CAD edges; see `EdgeAppearances`.

    Without knowledge of the light every crease counts, also those that a camera would not see.
    """
    return edge_appearances(part).expected_points(K, depth)


def nearest_groups(sizes: Sequence[int], expected: int, count: int = 3, tolerance: float = 0.10) -> list[int]:
    """Return the indices of the ``count`` groups nearest to P, those within (1 +- ``tolerance``) P first.

    Nearness is the difference in points, so that the tolerance changes nothing but says which groups are the paper's
    candidates; ties go to the lower index. Fewer groups give fewer indices.

    Args:
        sizes: Boundary points of each group.
        expected: P.
        count: 3 to 5 in the paper.
        tolerance: 0.1 in the paper.

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

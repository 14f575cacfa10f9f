"""Places in the bin where the pile is low."""

import cv2
import numpy as np

from perception.geometry import Floats, invert_transform, transform_points
from policies.grasping.heightmap import HeightMap


def low_places(heights: HeightMap, radius: float, count: int = 6) -> Floats:
    """Return the (K, 2) world x and y [m] of the lowest places of a disc, lowest first, at most ``count``.

    A place is as high as the highest thing under the disc, which touches no wall. Where the bin is narrower than the
    disc, there is none.

    Args:
        heights: Height map of the bin.
        radius: Radius of the disc [m].
        count: Largest number of places; they are at least half the radius apart.
    """
    cells = max(int(np.ceil(radius / heights.cell)), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * cells + 1, 2 * cells + 1))
    inner = heights.heights[heights.inner]
    if min(inner.shape) <= 2 * cells:
        return np.zeros((0, 2))
    highest = cv2.dilate(inner, disc)[cells:-cells, cells:-cells]
    corner = np.array([heights.inner[0].start, heights.inner[1].start]) + cells
    middle = (np.array(highest.shape) - 1) / 2
    i, j = np.indices(highest.shape).reshape(2, -1)
    # Among places of one height, to 2 mm, the one nearest to the middle of the bin.
    order = np.lexsort((np.hypot(i - middle[0], j - middle[1]), np.round(highest.ravel() / 0.002)))
    chosen: list[Floats] = []
    for k in order:
        cell = np.array([i[k], j[k]], dtype=np.float64)
        if all(np.linalg.norm(cell - other) >= cells / 2 for other in chosen):
            chosen.append(cell)
            if len(chosen) == count:
                break
    places_bin = heights.origin + heights.cell * (np.array(chosen) + corner + 0.5)
    T_world_bin = invert_transform(heights.T_bin_world)
    places_world: Floats = transform_points(T_world_bin, np.column_stack([places_bin, np.zeros(len(places_bin))]))[
        :, :2
    ]
    return places_world

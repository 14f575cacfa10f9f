"""Directions of view, spread evenly and the same for every part."""

from itertools import product
from typing import Literal

import numpy as np

from perception.geometry import Floats

ViewCount = Literal[1, 6, 14, 26]
VIEW_COUNTS: tuple[ViewCount, ...] = (1, 6, 14, 26)


def view_directions(count: ViewCount) -> Floats:
    """Return (V, 3) unit directions from a part towards the camera, in the part frame.

    They point to the faces of a cube (+z, -z, +x, -x, +y, -y), then to its corners, then to the middles of its edges. A
    smaller set is the beginning of a larger one, so that a single view looks down on +z.

    Raises:
        ValueError: ``count`` is none of 1, 6, 14 and 26.
    """
    if count not in VIEW_COUNTS:
        raise ValueError(f"views must be one of {list(VIEW_COUNTS)}, got {count}")
    faces = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]
    corners = list(product((1, -1), repeat=3))
    edges = [d for d in product((1, 0, -1), repeat=3) if d.count(0) == 1]
    directions = np.array([*faces, *corners, *edges], dtype=np.float64)[:count]
    units: Floats = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return units

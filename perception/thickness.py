"""The thickness of a part, which decides whether it stands out from the floor that it lies on."""

from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from perception.boundary import BoundarySettings
from perception.geometry import Floats
from perception.part import PartModel


@lru_cache(maxsize=16)
def part_thickness(part: PartModel) -> float:
    """Return the least distance of two parallel planes that enclose a part, one of them on a face of its hull [m]."""
    vertices: Floats = np.asarray(part.mesh.vertices, np.float64)
    hull = ConvexHull(vertices)
    corners = vertices[hull.vertices]
    normals = np.unique(hull.equations[:, :3].round(6), axis=0)
    blocks = np.array_split(normals, max(len(normals) * len(corners) // 4_000_000, 1))
    return min(float(np.ptp(corners @ block.T, axis=0).min()) for block in blocks)


def part_boundary(part: PartModel) -> BoundarySettings:
    """Return the default settings of boundary points for a part, with which a thin one stands out from the floor."""
    return BoundarySettings().for_thickness(part_thickness(part))

"""A part's surface as evenly spread samples with normals, to compare a pose with the measured depth."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception.geometry import Floats, require_shape
from perception.part import PartModel
from perception.pose.model import _surface_kernels

GRAZING = 0.2  # cosine of the incidence angle; beyond about 78 deg a surface is hardly ever measured
OVERSAMPLING = 12  # random points drawn for each one kept


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfaceModel:
    """Samples of a part's surface.

    Attributes:
        points: (M, 3) points on the surface, part frame [m].
        normals: (M, 3) unit outward normals.
        spacing: Least distance between two points on the same side of the surface [m].
        centre: (3,) centre of the part, part frame [m].
        d_max: Diameter of the part [m].
    """

    points: Floats
    normals: Floats
    spacing: float
    centre: Floats
    d_max: float

    def __post_init__(self) -> None:
        require_shape("points", self.points, (None, 3))
        require_shape("normals", self.normals, (len(self.points), 3))
        require_shape("centre", self.centre, (3,))
        if not (self.spacing > 0 and self.d_max > 0):
            raise ValueError(f"spacing and d_max must be positive, got {self.spacing} and {self.d_max}")

    def visible(self, T_cam_part: Floats) -> NDArray[np.bool_]:
        """Return (M,) whether each point faces the camera in a (4, 4) pose and is not self-occluded."""
        return _surface_kernels.visible_samples(T_cam_part, self.points, self.normals, GRAZING, self.spacing)


def surface_model(part: PartModel, spacing: float = 0.03) -> SurfaceModel:
    """Sample a part's surface evenly; the two sides of a thin wall are sampled separately.

    Args:
        part: Part whose surface is sampled.
        spacing: Least distance between two points, as a share of ``d_max``.

    Raises:
        ValueError: ``spacing`` is not between 0 and 1.

    Note:
        Deterministic. Takes a few tenths of a second.
    """
    if not 0 < spacing < 1:
        raise ValueError(f"spacing must be between 0 and 1, got {spacing}")
    radius = spacing * part.d_max
    count = OVERSAMPLING * int(np.ceil(part.mesh.area / radius**2))
    drawn, faces = trimesh.sample.sample_surface(part.mesh, count, seed=0)
    normals = np.asarray(part.mesh.face_normals, np.float64)[faces]
    # Normals that differ by about 30 deg separate two points as much as a distance of one radius does.
    kept = _first_ones(np.hstack([drawn, normals * (2 * radius)]), radius)
    return SurfaceModel(
        points=np.ascontiguousarray(drawn[kept], dtype=np.float64),
        normals=np.ascontiguousarray(normals[kept]),
        spacing=radius,
        centre=part.centre,
        d_max=part.d_max,
    )


def _first_ones(points: Floats, radius: float) -> NDArray[np.bool_]:
    """Return (N,) whether each point is kept if points within ``radius`` of an earlier kept one are dropped."""
    tree = cKDTree(points)
    kept = np.ones(len(points), np.bool_)
    for i in range(len(points)):
        if kept[i]:
            near = tree.query_ball_point(points[i], radius)
            kept[near] = False
            kept[i] = True
    return kept

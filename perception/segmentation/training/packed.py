"""A labelled scene in little memory."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.segmentation.networks.grid import place_in
from perception.segmentation.scene import BoundaryScene

Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class PackedScene:
    """The fields of a :class:`BoundaryScene` that training needs, in little memory: N points, P parts.

    Attributes:
        name: Folder and name of the file; "" for a scene without a file.
        surface: (h, w) depth of the fine cells [m], 0 where there is none.
        place_fine: (N, 2) column and row of each point in fine cells.
        points: (N, 3) boundary points in the camera frame [m].
        instance_ids: (N,) part of each point, -1 for the container.
        centres: (P, 3) centres of the parts in the camera frame [m].
        d_max: Largest extent of the part [m].
        shape: (5,) values that describe the part's shape, None if unknown.
    """

    name: str
    surface: Singles
    place_fine: Singles
    points: Singles
    instance_ids: NDArray[np.int16]
    centres: Singles
    d_max: float
    shape: Singles | None = None

    @classmethod
    def pack(cls, scene: BoundaryScene, name: str = "") -> "PackedScene":
        """Return the packed form of a scene."""
        return cls(
            name=name,
            surface=scene.surface.depth.astype(np.float32),
            place_fine=place_in(scene.surface, scene.boundary.pixels).astype(np.float32),
            points=scene.boundary.points_cam.astype(np.float32),
            instance_ids=scene.instance_ids.astype(np.int16),
            centres=scene.centres_cam.astype(np.float32),
            d_max=scene.d_max,
            shape=None if scene.shape is None else scene.shape.astype(np.float32),
        )

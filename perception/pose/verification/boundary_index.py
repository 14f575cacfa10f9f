"""Spatial index of boundary points by their place in the image, for fast matching with a posed model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape
from perception.pose.verification import _matching_kernels

MOST_CELLS = 1 << 20  # a stray point far aside makes the cells larger instead of adding more


@dataclass(frozen=True, eq=False, kw_only=True)
class BoundaryIndex:
    """N boundary points sorted by square cells of ``(x / z, y / z)``.

    Attributes:
        points_cam: (N, 3) float64 boundary points sorted by cell, camera frame [m].
        tangents_cam: (N, 3) unit tangents of these points, sign arbitrary; a point whose tangent is 0 is never matched.
        order: (N,) int64 index of each point in the cloud that the index was made from.
        starts: (rows * columns + 1,) int64 index of the first point of each cell, row after row.
        shape: Number of rows and columns of cells.
        origin: (2,) ``(x / z, y / z)`` of the first cell's corner.
        cell: Side of a cell in units of ``x / z``.
    """

    points_cam: Floats
    tangents_cam: Floats
    order: NDArray[np.int64]
    starts: NDArray[np.int64]
    shape: tuple[int, int]
    origin: Floats
    cell: float

    def __len__(self) -> int:
        return len(self.points_cam)

    @property
    def arrays(self) -> tuple[Floats, Floats, NDArray[np.int64], tuple[int, int], Floats, float]:
        """Points, tangents, starts, shape, origin and cell, in the order of the kernels' arguments."""
        return self.points_cam, self.tangents_cam, self.starts, self.shape, self.origin, self.cell

    def match(
        self,
        T_cam_part: Floats,
        points: Floats,
        tangents: Floats,
        *,
        gate: float,
        max_angle: float,
        depth_gate: float = 0.0,
    ) -> NDArray[np.int64]:
        """Return (M,) indices into ``points_cam`` of the nearest boundary point of like tangent, -1 for none.

        Args:
            T_cam_part: (4, 4) pose of the part in the camera frame.
            points: (M, 3) model points, part frame [m].
            tangents: (M, 3) unit tangents of the model points, sign arbitrary.
            gate: Largest distance of a match [m].
            max_angle: Largest angle between the tangents of a match as lines [rad].
            depth_gate: Largest distance along the line of sight, if it is more than ``gate`` [m].
        """
        return _matching_kernels.match_edges(
            T_cam_part,
            points,
            tangents,
            *self.arrays,
            gate,
            max(gate, depth_gate),
            float(np.cos(max_angle)),
        )


def index_boundary(points_cam: Floats, tangents_cam: Floats, d_max: float) -> BoundaryIndex:
    """Return the index of the boundary points of a scene or of a group.

    Args:
        points_cam: (N, 3) boundary points, camera frame [m].
        tangents_cam: (N, 3) unit tangents of the points, sign arbitrary, or 0.
        d_max: Diameter of the part that will be searched for, which sets the size of the cells [m].

    Raises:
        ValueError: There is no point, one is not finite or not before the camera, or ``d_max`` is not positive.

    Note:
        Takes about 3 ms for 25 000 points. One index serves all poses of the scene.
    """
    require_shape("points_cam", points_cam, (None, 3))
    require_shape("tangents_cam", tangents_cam, (len(points_cam), 3))
    if len(points_cam) == 0:
        raise ValueError("points_cam must hold at least one point, got none")
    if not (np.isfinite(points_cam).all() and np.isfinite(tangents_cam).all()):
        raise ValueError("points_cam and tangents_cam must be finite")
    if not (points_cam[:, 2] > 0).all():
        raise ValueError(f"points_cam must lie before the camera (z > 0), got z = {points_cam[:, 2].min()}")
    if not d_max > 0:
        raise ValueError(f"d_max must be positive, got {d_max}")
    seen = points_cam[:, :2] / points_cam[:, 2:]
    origin = seen.min(axis=0)
    extent = seen.max(axis=0) - origin
    cell = max(0.03 * d_max / float(np.median(points_cam[:, 2])), float(extent.max()) / np.sqrt(MOST_CELLS))
    columns, rows = (int(n) + 1 for n in extent / cell)
    places = np.floor((seen - origin) / cell).astype(np.int64)
    flat = places[:, 1] * columns + places[:, 0]
    order = np.argsort(flat, kind="stable")
    return BoundaryIndex(
        points_cam=np.ascontiguousarray(points_cam[order], dtype=np.float64),
        tangents_cam=np.ascontiguousarray(tangents_cam[order], dtype=np.float64),
        order=order,
        starts=np.searchsorted(flat[order], np.arange(rows * columns + 1)),
        shape=(rows, columns),
        origin=origin,
        cell=cell,
    )

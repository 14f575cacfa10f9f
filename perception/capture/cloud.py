"""A point cloud from a file, with or without the grid of pixels that it was measured in."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class Cloud:
    """A point cloud. Points that are not finite, or at the origin, are no measurements, whatever their colour says.

    Attributes:
        points: (H, W, 3) float64 points of an organised cloud, (1, N, 3) of an unorganised one, in the file's unit.
        grey: (H, W) uint8 grey value of each point; None if the file holds no colours.
        viewpoint: (4, 4) pose of the sensor that a PCD file states; None if it states none or the identity.
    """

    points: Floats
    grey: NDArray[np.uint8] | None = None
    viewpoint: Floats | None = None

    def __post_init__(self) -> None:
        if self.points.ndim != 3 or self.points.shape[2] != 3:
            raise ValueError(f"points must be (H, W, 3), got {self.points.shape}")
        if self.grey is not None and self.grey.shape != self.points.shape[:2]:
            raise ValueError(f"grey must be {self.points.shape[:2]} as the points are, got {self.grey.shape}")

    def in_grid(self, width: int, height: int) -> "Cloud":
        """Return the cloud with its points laid out in rows of a grid, from left to right and top to bottom.

        Raises:
            ValueError: The grid has another number of cells.
        """
        count = self.points.shape[0] * self.points.shape[1]
        if count != width * height:
            raise ValueError(f"grid must have a cell for each of the {count} points, got {width} x {height}")
        return Cloud(
            points=self.points.reshape(height, width, 3),
            grey=None if self.grey is None else self.grey.reshape(height, width),
            viewpoint=self.viewpoint,
        )

    @property
    def organised(self) -> bool:
        """Whether the points lie in a grid of pixels, so that neither side of it is 1."""
        return bool(min(self.points.shape[:2]) > 1)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(H, W) mask of the points that were measured; x, y and z alone decide."""
        return measured(self.points)


def measured(points: Floats) -> NDArray[np.bool_]:
    """Return the (...) mask of the points among (..., 3) that are finite and not at the origin."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    mask: NDArray[np.bool_] = np.isfinite(x) & np.isfinite(y) & np.isfinite(z) & ((x != 0) | (y != 0) | (z != 0))
    return mask

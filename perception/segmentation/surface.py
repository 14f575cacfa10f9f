"""The coarse surface: depth of the nearest surface in square cells of the image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.boundary import BoundarySettings
from perception.frame import Frame, Workspace, bin_region
from perception.geometry import NEAR, require_shape
from perception.segmentation import _surface_kernels as _kernels

CELLS_PER_D_MAX = 80  # cells per largest extent of the part; the network's cells, twice as large, are sampled from them
STEP = BoundarySettings.step  # depths in a cell that differ by less belong to one surface [m]
HEADROOM = BoundarySettings.headroom  # height above the rim up to which a heaped pile is seen [m]


@dataclass(frozen=True, eq=False, kw_only=True)
class Surface:
    """Depth of the nearest surface in square cells of the image.

    Attributes:
        depth: (h, w) float32 depth of each cell [m], 0 where nothing was measured.
        u0: Pixel column of the left border of the first cell.
        v0: Pixel row of the upper border of the first cell.
        cell: Side of a cell [px].
    """

    depth: NDArray[np.float32]
    u0: float
    v0: float
    cell: float

    def __post_init__(self) -> None:
        require_shape("depth", self.depth, (None, None))
        if not self.cell > 0:
            raise ValueError(f"cell must be positive, got {self.cell}")


def coarse_surface(frame: Frame, workspace: Workspace, d_max: float) -> Surface:
    """Return the coarse surface of the region of the image that shows the bin.

    A cell is about ``d_max / 80`` wide at the floor of the bin, and at least a pixel.

    Args:
        frame: Frame of the camera.
        workspace: Pose and size of the bin.
        d_max: Largest extent of the part [m].

    Raises:
        ValueError: ``d_max`` is not positive, too large for the bin, or so small that a cell is under half a pixel.
    """
    if not d_max > 0:
        raise ValueError(f"d_max must be positive, got {d_max}")
    if d_max > np.linalg.norm(workspace.inner_size):
        size_mm = " x ".join(f"{1000 * value:.0f}" for value in workspace.inner_size)
        raise ValueError(
            f"a part of d_max {1000 * d_max:.0f} mm does not fit into a bin of {size_mm} mm (is its model in metres?)"
        )
    size = (frame.depth.shape[1], frame.depth.shape[0])
    u0, v0, u1, v1 = bin_region(workspace, frame.K, frame.T_world_cam, size, margin=0.0, headroom=HEADROOM).tolist()
    floor = workspace.T_world_bin[:3, 3]
    distance = max(float(np.linalg.norm(floor - frame.T_world_cam[:3, 3])), NEAR)
    cell = d_max / CELLS_PER_D_MAX * frame.K[0, 0] / distance
    if cell < 0.5:
        raise ValueError(
            f"a part of d_max {1000 * d_max:.1f} mm is {cell * CELLS_PER_D_MAX:.0f} px long at the bin's floor, "
            f"{distance:.3g} m from the camera; at least {CELLS_PER_D_MAX // 2} px are needed: move the camera nearer "
            "(--camera-distance), unless its model is not in metres, or T_world_cam or T_world_bin"
        )
    cell = max(cell, 1.0)  # a smaller cell may contain no pixel
    shape = (int(np.ceil((v1 - v0) / cell)), int(np.ceil((u1 - u0) / cell)))
    depth = _kernels.nearest_surface(frame.depth, u0, v0, cell, shape, STEP)
    return Surface(depth=depth, u0=float(u0), v0=float(v0), cell=cell)

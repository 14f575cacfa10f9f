"""Inputs of the image-plane network: coarse cells of depth and boundary density, and the points in them.

A coarse cell, on which the network works, is 2 x 2 fine cells. A fine cell is one of :class:`Surface`,
about d_max / 80.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats
from perception.segmentation.surface import Surface

FINE = 2  # number of fine cells along the side of a coarse cell
CHANNELS = 4 * FINE * FINE  # channels of a coarse cell: height, detail, measured and density of its fine cells
LOCAL = 4  # number of local features of a point
DETAIL_WINDOW = 9  # side of the window whose mean height is subtracted from the height to give the detail [fine cells]
DETAIL_SCALE = 0.05  # height of a detail of value 1, in units of d_max
MULTIPLE = 16  # numbers of cells are multiples of this, as the network halves its grid four times

Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False, kw_only=True)
class GridView:
    """A scene, or a crop of it, in cells.

    Attributes:
        cells: (CHANNELS, H, W) float32 channels of the coarse cells; H and W are multiples of 16.
        place: (N, 2) float32 column and row of each point in coarse cells; the centre of the first cell is (0.5, 0.5).
        local: (N, LOCAL) float32 local features of each point: position within the fine cell (2), height over the
            surface of the cell, height.
    """

    cells: Singles
    place: Singles
    local: Singles


def view_grid(
    surface: Singles,
    place_fine: Floats,
    depths: Floats,
    d_max: float,
    reference: float,
    keep: NDArray[np.bool_] | None = None,
) -> GridView:
    """Return the inputs of the network.

    Args:
        surface: (h, w) depth of the fine cells [m], 0 where there is none.
        place_fine: (N, 2) column and row of each boundary point in fine cells.
        depths: (N,) depth of each boundary point [m].
        d_max: Largest extent of the part, the unit of height [m].
        reference: Depth of height 0 [m].
        keep: (N,) mask of the points that count in the density; all unless given. Points off the grid never count.
    """
    rows, columns = (-(-size // (FINE * MULTIPLE)) * FINE * MULTIPLE for size in surface.shape)
    depth = np.zeros((rows, columns), np.float32)
    depth[: surface.shape[0], : surface.shape[1]] = surface
    measured = (depth > 0).astype(np.float32)
    height = np.where(depth > 0, (reference - depth) / d_max, 0).astype(np.float32)
    window = (DETAIL_WINDOW, DETAIL_WINDOW)
    mean = cv2.blur(height, window) / np.maximum(cv2.blur(measured, window), 1e-3)
    detail = np.clip((height - mean) * measured / DETAIL_SCALE, -3.0, 3.0)
    at = np.floor(place_fine).astype(np.int64)
    drawn = (at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < columns) & (at[:, 1] < rows)
    flat = np.clip(at[:, 1], 0, rows - 1) * columns + np.clip(at[:, 0], 0, columns - 1)
    shown = flat[drawn if keep is None else drawn & keep]
    density = np.bincount(shown, minlength=rows * columns).reshape(rows, columns).astype(np.float32)
    fine = np.stack([height, detail, measured, np.minimum(density, 3.0) / 3.0])
    cells = fine.reshape(4, rows // FINE, FINE, columns // FINE, FINE).transpose(0, 2, 4, 1, 3)
    own = (reference - depths) / d_max
    over = np.where(measured.ravel()[flat] > 0, np.clip((own - height.ravel()[flat]) / DETAIL_SCALE, -3.0, 3.0), 0.0)
    within = place_fine - at - 0.5
    return GridView(
        cells=np.ascontiguousarray(cells.reshape(CHANNELS, rows // FINE, columns // FINE)),
        place=(place_fine / FINE).astype(np.float32),
        local=np.column_stack([within, over, own]).astype(np.float32),
    )


def place_in(surface: Surface, pixels: NDArray[np.integer]) -> Floats:
    """Return the (N, 2) columns and rows in fine cells of the centres of (N, 2) pixels (u, v)."""
    return np.asarray((pixels - (surface.u0, surface.v0) + 0.5) / surface.cell, np.float64)

"""Boundary points: Canny edges of the grey image, mapped to the organised cloud (section III of the paper)."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from perception import _boundary_kernels as _kernels
from perception.frame import Frame, Workspace, bin_region
from perception.geometry import Floats, require_shape, transform_points


@dataclass(frozen=True, eq=False, kw_only=True)
class BoundaryCloud:
    """The boundary points of one frame. :func:`extract_boundary` returns them row by row, from left to right.

    Attributes:
        points_cam: (N, 3) float64 points in the camera frame [m].
        tangents_cam: (N, 3) float64 unit tangents of the edge in the camera frame, of either sign; 0 where a point has
            no neighbours.
        linearity: (N,) float64 straightness of the edge: 1 on a straight edge, near 0 at corners and in clutter.
        pixels: (N, 2) int64 pixels (u, v) that the depths were taken from, no two of them equal.
        outside: Number of edge points in the image of the bin that lie outside its box and were removed.
    """

    points_cam: Floats
    tangents_cam: Floats
    linearity: Floats
    pixels: NDArray[np.int64]
    outside: int = 0

    def __post_init__(self) -> None:
        require_shape("points_cam", self.points_cam, (None, 3))
        count = len(self.points_cam)
        require_shape("tangents_cam", self.tangents_cam, (count, 3))
        require_shape("linearity", self.linearity, (count,))
        require_shape("pixels", self.pixels, (count, 2))
        if not np.isfinite(self.points_cam).all():
            bad = int(np.nonzero(~np.isfinite(self.points_cam).all(axis=1))[0][0])
            raise ValueError(f"points_cam must be finite, point {bad} is {self.points_cam[bad].tolist()}")

    def __len__(self) -> int:
        return len(self.points_cam)

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.integer]) -> "BoundaryCloud":
        """Return the cloud of the points that ``chosen`` selects.

        Args:
            chosen: (N,) mask, or indices in any order.
        """
        return BoundaryCloud(
            points_cam=self.points_cam[chosen],
            tangents_cam=self.tangents_cam[chosen],
            linearity=self.linearity[chosen],
            pixels=self.pixels[chosen],
        )


@dataclass(frozen=True, kw_only=True)
class BoundarySettings:
    """Settings of the edge detector and of the mapping from pixels to points."""

    low: float = 15.0  # Canny's weak threshold [grey levels]
    high: float = 40.0  # Canny's strong threshold [grey levels]
    blur: float = 1.0  # standard deviation of the Gaussian before Canny [px]; without it, rounding draws false edges
    radius: int = 2  # half the side of the window in which the nearest surface is searched [px]
    widest: int = 6  # half the side up to which the window grows over pixels without depth [px]
    step: float = 0.003  # depths in a window that differ by less belong to one surface [m]
    window: int = 8  # half the side of the window in which a tangent is fitted [px]
    margin: float = 0.003  # points closer to the walls and the floor of the bin belong to the container [m]
    headroom: float = 0.03  # height above the rim up to which points of a heaped pile are kept [m]

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high:
            raise ValueError(f"low must be between 0 and high, got {self.low} and {self.high}")
        if not 0 <= self.radius <= self.widest:
            raise ValueError(f"radius must be between 0 and widest, got {self.radius} and {self.widest}")
        if self.window < 1:
            raise ValueError(f"window must be at least 1 px, got {self.window}")
        for name in ("blur", "step", "margin", "headroom"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")


def extract_boundary(frame: Frame, workspace: Workspace, settings: BoundarySettings | None = None) -> BoundaryCloud:
    """Return the boundary points of what lies in the bin; none for an empty bin or a frame without depth.

    An edge pixel between two surfaces may lie on either of them. Its depth is taken from the nearer surface, which the
    edge belongs to. Where depth is missing, the search window grows. Points outside the inner box of the bin (container
    and table) are removed.

    Source: section III of the paper; the mapping is described in Liu et al., "PPF-MEAM", Sensors 18 (2018).

    Args:
        frame: Frame of a calibrated depth camera with a registered grey image.
        workspace: Pose and size of the bin.
        settings: Edge detector and mapping; the defaults of :class:`BoundarySettings` if left out.
    """
    settings = settings or BoundarySettings()
    size = (frame.depth.shape[1], frame.depth.shape[0])
    u0, v0, u1, v1 = bin_region(
        workspace, frame.K, frame.T_world_cam, size, margin=0.0, headroom=settings.headroom
    ).tolist()
    if u1 - u0 < 3 or v1 - v0 < 3:
        return _cloud(frame, np.zeros((0, 2), np.int64), settings)
    edges = _edge_pixels(frame.grey[v0:v1, u0:u1], settings) + np.array([u0, v0])
    sources = _kernels.foreground_pixels(edges, frame.depth, settings.radius, settings.widest, settings.step)
    sources = sources[sources[:, 0] >= 0]
    flat = np.unique(sources[:, 1] * size[0] + sources[:, 0])
    pixels = np.column_stack([flat % size[0], flat // size[0]])
    points_world = transform_points(frame.T_world_cam, organised_points(frame, pixels))
    inside = workspace.contains(points_world, margin=settings.margin, headroom=settings.headroom)
    return replace(_cloud(frame, pixels[inside], settings), outside=int(np.count_nonzero(~inside)))


def organised_points(frame: Frame, pixels: NDArray[np.int64]) -> Floats:
    """Return the (N, 3) points in the camera frame [m] that (N, 2) pixels (u, v) show."""
    z = frame.depth[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    x = (pixels[:, 0] - frame.K[0, 2]) / frame.K[0, 0]
    y = (pixels[:, 1] - frame.K[1, 2]) / frame.K[1, 1]
    return np.column_stack([x * z, y * z, z])


def _edge_pixels(grey: NDArray[np.uint8], settings: BoundarySettings) -> NDArray[np.int64]:
    image = cv2.GaussianBlur(grey, (0, 0), settings.blur) if settings.blur > 0 else np.ascontiguousarray(grey)
    edges = cv2.Canny(image, settings.low, settings.high, L2gradient=True)
    v, u = np.nonzero(edges)
    return np.column_stack([u, v]).astype(np.int64)


def _cloud(frame: Frame, pixels: NDArray[np.int64], settings: BoundarySettings) -> BoundaryCloud:
    points_cam = organised_points(frame, pixels)
    index_at = np.full(frame.depth.shape, -1, np.int32)
    index_at[pixels[:, 1], pixels[:, 0]] = np.arange(len(pixels))
    tangents_cam, linearity = _kernels.edge_tangents(
        pixels, points_cam, index_at, frame.K, settings.window, settings.step
    )
    return BoundaryCloud(points_cam=points_cam, tangents_cam=tangents_cam, linearity=linearity, pixels=pixels)

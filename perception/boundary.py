"""Boundary points: Canny on the grey image, mapped to the organised cloud (section III of the paper)."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception import _boundary_kernels as _kernels
from perception.frame import Frame, Workspace, bin_region
from perception.geometry import Floats, require_shape, transform_points


@dataclass(frozen=True, eq=False, kw_only=True)
class BoundaryCloud:
    """The boundary points of one frame; :func:`extract_boundary` gives them in reading order of their pixels.

    Attributes:
        points_cam: (N, 3) float64 [m].
        tangents_cam: (N, 3) float64 unit direction of the edge, sign arbitrary; 0 where it has none.
        linearity: (N,) float64, 1 on a straight edge, towards 0 at corners and in clutter.
        pixels: (N, 2) int64 (u, v) of the pixel whose depth the point has; no two are the same.
    """

    points_cam: Floats
    tangents_cam: Floats
    linearity: Floats
    pixels: NDArray[np.int64]

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
        """Return the cloud of some of the points: by a mask (N,), or by their indices in any order."""
        return BoundaryCloud(
            points_cam=self.points_cam[chosen],
            tangents_cam=self.tangents_cam[chosen],
            linearity=self.linearity[chosen],
            pixels=self.pixels[chosen],
        )


@dataclass(frozen=True, kw_only=True)
class BoundarySettings:
    """How edges are found and turned into points."""

    low: float = 15.0  # Canny's weak threshold [grey levels]
    high: float = 40.0  # Canny's strong threshold [grey levels]
    blur: float = 1.0  # standard deviation of a Gaussian before Canny [px]: rounding alone draws lines on a cylinder
    radius: int = 2  # of the patch in which the nearest surface is taken [px]
    widest: int = 6  # how far that patch may grow over pixels without depth [px]
    step: float = 0.003  # depths of one patch that differ by less are one surface [m]
    window: int = 8  # of the tangent [px]
    margin: float = 0.003  # points closer to the bin's walls and floor than this are the container's [m]
    headroom: float = 0.03  # of a heaped pile over the rim [m]

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

    An edge pixel between two surfaces may fall on either; its point is taken from the nearer one, whose edge it is, and
    where depth is missing a growing window is searched. Container and table are removed by the bin's known pose and
    size.

    Source: section III of the paper, after Liu et al., "PPF-MEAM", Sensors 18 (2018), which describes the mapping.

    Args:
        frame: Of any calibrated depth camera with a registered grey image.
        workspace: The bin.
        settings: :class:`BoundarySettings`' defaults if left out.
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
    return _cloud(frame, pixels[inside], settings)


def organised_points(frame: Frame, pixels: NDArray[np.int64]) -> Floats:
    """Return the (N, 3) camera points of (N, 2) pixels (u, v) of the organised cloud [m]."""
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

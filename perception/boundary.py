"""Boundary points: edges of the grey image and of the depth, on the organised cloud (section III of the paper)."""

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from perception import _boundary_kernels as _kernels
from perception.depth_edges import DepthEdgeSettings, depth_edges
from perception.frame import Frame, Workspace, bin_region
from perception.geometry import Floats, pixel_rays, require_shape, transform_points
from perception.runtime.sorting import distinct

BoundarySource = Literal["grey", "depth", "both"]
THIN = 0.0005  # height by which the top of a part must exceed the margin, for the sake of noise [m]
_SAME = 2  # a depth edge this near to a boundary point of a grey edge is the same edge [px]
COVERED = 0.001  # uncertainty of the bin's surfaces that the margin already allows for, as a standard deviation [m]
UNCERTAIN = 1.0  # growth of the box of kept points per metre of standard deviation beyond that


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
        source: Images that the edges were found in.
    """

    points_cam: Floats
    tangents_cam: Floats
    linearity: Floats
    pixels: NDArray[np.int64]
    outside: int = 0
    source: BoundarySource = "grey"

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
            source=self.source,
        )


@dataclass(frozen=True, kw_only=True)
class BoundarySettings:
    """Settings of the edge detectors and of the mapping from pixels to points."""

    # images that edges are found in; without a grey image it is always the depth
    source: BoundarySource = "grey"
    low: float = 15.0  # Canny's weak threshold [grey levels]
    high: float = 40.0  # Canny's strong threshold [grey levels]
    blur: float = 1.0  # standard deviation of the Gaussian before Canny [px]; without it, rounding draws false edges
    radius: int = 2  # half the side of the window in which the nearest surface is searched [px]
    widest: int = 6  # half the side up to which the window grows over pixels without depth [px]
    step: float = 0.003  # depths in a window that differ by less belong to one surface [m]
    window: int = 8  # half the side of the window in which a tangent is fitted [px]
    margin: float = 0.003  # points closer to the walls and the floor of the bin belong to the container [m]
    floor: float | None = None  # distance from the floor up to which points belong to it [m]; None for margin
    headroom: float = 0.03  # height above the rim up to which points of a heaped pile are kept [m]
    depth: DepthEdgeSettings = field(default_factory=DepthEdgeSettings)  # steps and creases of the depth

    def __post_init__(self) -> None:
        if self.source not in get_args(BoundarySource):
            raise ValueError(f"source must be one of {', '.join(get_args(BoundarySource))}, got {self.source!r}")
        if not 0 <= self.low <= self.high:
            raise ValueError(f"low must be between 0 and high, got {self.low} and {self.high}")
        if not 0 <= self.radius <= self.widest:
            raise ValueError(f"radius must be between 0 and widest, got {self.radius} and {self.widest}")
        if self.window < 1:
            raise ValueError(f"window must be at least 1 px, got {self.window}")
        for name in ("blur", "step", "margin", "headroom", "floor"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < np.inf:
                raise ValueError(f"{name} must not be negative, got {value}")

    def for_thickness(self, thickness: float) -> "BoundarySettings":
        """Return the settings with which a part that lies flat on the floor stands out from it.

        Points of a part that is hardly thicker than ``margin`` would count as the floor's. For such a part, points
        belong to the floor up to half its thickness, and depths that differ by more than that to different surfaces.

        Args:
            thickness: Least distance of two parallel planes that enclose the part [m].
        """
        if self.floor is not None or thickness > self.margin + THIN:
            return self
        return replace(self, floor=thickness / 2, step=min(self.step, thickness / 2))


def extract_boundary(frame: Frame, workspace: Workspace, settings: BoundarySettings | None = None) -> BoundaryCloud:
    """Return the boundary points of what lies in the bin; none for an empty bin or a frame without depth.

    Grey edges are found by Canny's detector. A grey edge pixel between two surfaces may lie on either of them. Its
    depth is taken from the nearer surface, which the edge belongs to. Where depth is missing, the search window grows.
    Depth edges are steps and creases; see :func:`~perception.depth_edges.depth_edges`. If both are looked for, depth
    edges beside a point of a grey edge are left out. Points outside the inner box of the bin (container and table) are
    removed.

    Source: section III of the paper; the mapping is described in Liu et al., "PPF-MEAM", Sensors 18 (2018). Depth edges
    are an addition.

    Args:
        frame: Frame of a calibrated depth camera. Without a registered grey image the edges are those of the depth.
        workspace: Pose and size of the bin.
        settings: Edge detectors and mapping; the defaults of :class:`BoundarySettings` if left out.
    """
    settings = settings or BoundarySettings()
    source: BoundarySource = settings.source if settings.source == "depth" or frame.has_grey else "depth"
    size = (frame.depth.shape[1], frame.depth.shape[0])
    u0, v0, u1, v1 = bin_region(
        workspace, frame.K, frame.T_world_cam, size, margin=0.0, headroom=settings.headroom
    ).tolist()
    if u1 - u0 < 3 or v1 - v0 < 3:
        return replace(_cloud(frame, np.zeros((0, 2), np.int64), settings), source=source)
    edges = np.zeros((0, 2), np.int64)
    if source != "depth":
        edges = _edge_pixels(frame.grey[v0:v1, u0:u1], settings) + np.array([u0, v0])
        edges = _foreground(edges, frame, settings)
    if source != "grey":
        found = depth_edges(frame.depth[v0:v1, u0:u1], frame.K, settings.depth)
        if len(edges):
            known = np.zeros(found.shape, np.uint8)
            within = np.all((edges >= (u0, v0)) & (edges < (u1, v1)), axis=1)
            known[edges[within, 1] - v0, edges[within, 0] - u0] = 1
            found &= cv2.dilate(known, np.ones((2 * _SAME + 1,) * 2, np.uint8)) == 0
        v, u = np.nonzero(found)
        more = np.column_stack([u, v]).astype(np.int64) + np.array([u0, v0])
        edges = np.concatenate([edges, _foreground(more, frame, settings)])
    flat = distinct(edges[:, 1] * size[0] + edges[:, 0])
    pixels = np.column_stack([flat % size[0], flat // size[0]])
    points_world = transform_points(frame.T_world_cam, organised_points(frame, pixels))
    # Parts may seem to lie in a floor or a wall whose place is uncertain.
    longer = int(np.argmax(workspace.inner_size[:2]))
    end = workspace.T_world_bin[:3, 3] + workspace.T_world_bin[:3, longer] * workspace.inner_size[longer] / 2
    uncertain = UNCERTAIN * max(workspace.std_at(end) - COVERED, 0.0)
    floor = (settings.margin if settings.floor is None else settings.floor) - uncertain
    inside = workspace.contains(
        points_world, margin=settings.margin - uncertain, headroom=settings.headroom, floor=floor
    )
    outside = int(np.count_nonzero(~inside))
    return replace(_cloud(frame, pixels[inside], settings), outside=outside, source=source)


def organised_points(frame: Frame, pixels: NDArray[np.int64]) -> Floats:
    """Return the (N, 3) points in the camera frame [m] that (N, 2) pixels (u, v) show."""
    z = frame.depth[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    return pixel_rays(frame.K, pixels) * z[:, None]


def _edge_pixels(grey: NDArray[np.uint8], settings: BoundarySettings) -> NDArray[np.int64]:
    image = cv2.GaussianBlur(grey, (0, 0), settings.blur) if settings.blur > 0 else np.ascontiguousarray(grey)
    edges = cv2.Canny(image, settings.low, settings.high, L2gradient=True)
    v, u = np.nonzero(edges)
    return np.column_stack([u, v]).astype(np.int64)


def _foreground(edges: NDArray[np.int64], frame: Frame, settings: BoundarySettings) -> NDArray[np.int64]:
    """Return the (M, 2) pixels that edge pixels take their depths from; those without a depth near are left out."""
    found = _kernels.foreground_pixels(edges, frame.depth, settings.radius, settings.widest, settings.step)
    return found[found[:, 0] >= 0]


def _cloud(frame: Frame, pixels: NDArray[np.int64], settings: BoundarySettings) -> BoundaryCloud:
    points_cam = organised_points(frame, pixels)
    index_at = np.full(frame.depth.shape, -1, np.int32)
    index_at[pixels[:, 1], pixels[:, 0]] = np.arange(len(pixels))
    tangents_cam, linearity = _kernels.edge_tangents(
        pixels, points_cam, index_at, frame.K, settings.window, settings.step
    )
    return BoundaryCloud(points_cam=points_cam, tangents_cam=tangents_cam, linearity=linearity, pixels=pixels)

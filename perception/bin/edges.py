"""The inner edges of a rim, found along lines across them in the full image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.bin.opening import rim_tolerance
from perception.frame import Frame
from perception.geometry import NEAR, Floats

SIDES = ((0, 1), (0, -1), (1, 1), (1, -1))  # axis and sign of the walls: x+, x-, y+, y-
LINES = 100  # lines across each edge
_SPAN = 0.94  # share of a side that they are spread over: its corners may be rounded
_SHARE = 0.2  # least share of them on a straight edge with which a side counts as seen
_SPREAD = 0.3  # least part of the side that these span
_CLEAR = 0.8  # least share of the samples on both sides of an edge that are as they should be


@dataclass(frozen=True, eq=False, kw_only=True)
class RimEdges:
    """Points on the inner edges of a rim.

    Attributes:
        points_cam: (N, 3) points in the camera frame [m].
        sides: (N,) index of each point's side in `SIDES`.
        offsets: (4,) mean distance of each side's points outside the assumed opening [m]; NaN for sides not seen.
    """

    points_cam: Floats
    sides: NDArray[np.int64]
    offsets: Floats


_NO_EDGES = RimEdges(points_cam=np.zeros((0, 3)), sides=np.zeros(0, np.int64), offsets=np.full(4, np.nan))


@dataclass(frozen=True, eq=False, kw_only=True)
class AssumedRim:
    """Where a rim is assumed to be.

    Attributes:
        T_cam_bin: (4, 4) pose of the bin.
        opening: (2,) length and width between its inner edges [m].
        height: Height of the rim above the bin's floor [m].
        noise: Standard deviation of the depth measurements [m].
    """

    T_cam_bin: Floats
    opening: Floats
    height: float
    noise: float


def find_edges(frame: Frame, rim: AssumedRim, reach: float) -> RimEdges:
    """Return points on the inner edges of a rim near its assumed place.

    Args:
        frame: Frame of the camera.
        rim: Where the rim is assumed to be.
        reach: Distance from an assumed edge up to which it is looked for [m].

    Returns:
        The points; none if the rim's middle is not in front of the camera.
    """
    depth = float(rim.T_cam_bin[2, 3] + rim.height * rim.T_cam_bin[2, 2])
    if depth <= NEAR:
        return _NO_EDGES
    pixel = depth / float(frame.K[0, 0])
    step = pixel / 2
    window = max(round(max(0.002, 3 * pixel) / step), 2)
    across = step * (np.arange(-int(reach / step) - window, int(reach / step) + window + 1))
    points, sides, offsets = [], [], np.full(4, np.nan)
    for k, (axis, sign) in enumerate(SIDES):
        along: Floats = np.linspace(-_SPAN / 2, _SPAN / 2, LINES, dtype=np.float64) * float(rim.opening[1 - axis])
        samples_bin = np.empty((LINES, len(across), 3))
        samples_bin[..., axis] = sign * (rim.opening[axis] / 2 + across)
        samples_bin[..., 1 - axis] = along[:, None]
        samples_bin[..., 2] = rim.height
        heights = _heights(frame, rim, samples_bin.reshape(-1, 3)).reshape(LINES, len(across))
        first = _steps_up(heights, rim_tolerance(rim.noise), window)
        found = np.flatnonzero(first > 0)
        outside = np.asarray(across[first[found]] - step / 2, np.float64)
        kept = _straight(along[found], outside, max(2 * pixel, 0.0005))
        if len(kept) < _SHARE * LINES or np.ptp(along[found][kept]) < _SPREAD * rim.opening[1 - axis]:
            continue
        edge_bin = np.empty((len(kept), 3))
        edge_bin[:, axis] = sign * (rim.opening[axis] / 2 + outside[kept])
        edge_bin[:, 1 - axis] = along[found][kept]
        edge_bin[:, 2] = rim.height
        points.append(edge_bin @ rim.T_cam_bin[:3, :3].T + rim.T_cam_bin[:3, 3])
        sides.append(np.full(len(kept), k))
        offsets[k] = float(np.mean(outside[kept]))
    if not points:
        return _NO_EDGES
    return RimEdges(points_cam=np.concatenate(points), sides=np.concatenate(sides), offsets=offsets)


def _heights(frame: Frame, rim: AssumedRim, points_bin: Floats) -> Floats:
    """Return how far above the rim lies what the pixels of (N, 3) points of its plane see [m]: NaN for nothing."""
    points_cam = points_bin @ rim.T_cam_bin[:3, :3].T + rim.T_cam_bin[:3, 3]
    uvw = points_cam @ frame.K.T
    z = np.maximum(uvw[:, 2], 1e-3)
    u, v = np.rint(uvw[:, 0] / z), np.rint(uvw[:, 1] / z)
    height, width = frame.depth.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    depth = np.zeros(len(z))
    depth[inside] = frame.depth[v[inside].astype(np.int64), u[inside].astype(np.int64)]
    normal = rim.T_cam_bin[:3, 2]
    # The points lie on the plane: a measured point on the same ray is higher by the missing share of its depth.
    above = (depth / z - 1) * (points_cam @ normal)
    return np.where(depth > 0, above, np.nan)


def _steps_up(heights: Floats, tolerance: float, window: int) -> NDArray[np.int64]:
    """Return the index of the first sample on the rim of each of (N, M) lines that go outwards; 0 without an edge."""
    with np.errstate(invalid="ignore"):
        on_rim = np.abs(heights) <= tolerance
        lower = ~(heights >= -tolerance)  # nothing measured counts as lower: a shadow, a steep wall
    rim_sums = np.pad(np.cumsum(on_rim, axis=1, dtype=np.int32), ((0, 0), (1, 0)))
    low_sums = np.pad(np.cumsum(lower, axis=1, dtype=np.int32), ((0, 0), (1, 0)))
    middle = slice(window, heights.shape[1] - window)
    after = rim_sums[:, 2 * window : -1] - rim_sums[:, window : -window - 1]
    before = low_sums[:, window : -window - 1] - low_sums[:, : -2 * window - 1]
    clear = np.minimum(after, before)
    score = np.where(on_rim[:, middle] & (clear >= _CLEAR * window), after + before, -1)
    best = np.argmax(score, axis=1)
    return np.where(score[np.arange(len(score)), best] > 0, best + window, 0)


def _straight(along: Floats, outside: Floats, tolerance: float) -> NDArray[np.int64]:
    """Return the indices of the points on the line that most of (N,) points support."""
    count = len(along)
    if count < 4:
        return np.zeros(0, np.int64)
    i = np.repeat(np.arange(count), 4)
    j = (i + np.tile([count // 5, count // 3, count // 2, 2 * count // 3], count) + 1) % count
    i, j = i[along[i] != along[j]], j[along[i] != along[j]]
    slopes = (outside[j] - outside[i]) / (along[j] - along[i])
    i, slopes = i[np.abs(slopes) < 0.2], slopes[np.abs(slopes) < 0.2]
    if len(i) == 0:
        return np.zeros(0, np.int64)
    away = np.abs(outside[None] - outside[i][:, None] - slopes[:, None] * (along[None] - along[i][:, None]))
    best = int(np.argmax(np.count_nonzero(away <= tolerance, axis=1)))
    return np.flatnonzero(away[best] <= tolerance)

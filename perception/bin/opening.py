"""The opening of a bin as a hole in the plane of its rim: a first guess of its pose."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.bin.cloud import GridCloud, Plane
from perception.geometry import Floats, make_transform, pixel_rays

LEAST_DEPTH = 0.01  # depth below the rim from which a point lies in the bin [m]
_LEAST_SIDE = 0.03  # side of the smallest opening that is looked for [m]
_LEAST_SHARE = 0.1  # share of the opening in which points below the rim are measured
_CLOSED = 5  # gaps of the rim up to about this wide are closed [cells of the grid]
_NOTHING, _RIM, _ABOVE, _BELOW = range(4)


@dataclass(frozen=True, eq=False, kw_only=True)
class Opening:
    """A rectangular hole in a plane.

    Attributes:
        T_cam_opening: (4, 4) pose of its centre, z along the plane's normal, x along its length.
        size: (2,) length and width [m].
        rim: Share of its outline beside which the plane was measured, in [0, 1].
    """

    T_cam_opening: Floats
    size: Floats
    rim: float


def find_openings(cloud: GridCloud, plane: Plane, x_cam: Floats) -> list[Opening]:
    """Return the holes of a plane behind which there is something lower, the largest first.

    The length of an opening is its side along ``x_cam``, not its longer side.

    Args:
        cloud: Points of the frame.
        plane: Plane of the rim.
        x_cam: (3,) expected direction of the length, in the camera frame.
    """
    seen = _classes(cloud, plane)
    closing = np.ones((_CLOSED, _CLOSED), np.uint8)
    blocked = cv2.morphologyEx(np.isin(seen, (_RIM, _ABOVE)).astype(np.uint8), cv2.MORPH_CLOSE, closing)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(1 - blocked, connectivity=4)
    T_cam_plane = _frame_of(plane, x_cam)
    rows, columns = seen.shape
    openings = []
    for k in range(1, count):
        u0, v0, width, height, area = stats[k].tolist()
        if u0 == 0 or v0 == 0 or u0 + width == columns or v0 + height == rows or area < 30:
            continue
        hole = labels[v0 : v0 + height, u0 : u0 + width] == k
        below = np.count_nonzero(hole & (seen[v0 : v0 + height, u0 : u0 + width] == _BELOW))
        if below >= _LEAST_SHARE * area:
            openings.append(_rectangle(hole, (u0, v0), cloud, plane, T_cam_plane))
    openings = [opening for opening in openings if opening.size.min() >= _LEAST_SIDE]
    openings = [_with_rim(opening, seen, cloud) for opening in openings]
    return sorted(openings, key=lambda opening: -float(np.prod(opening.size)))


def _classes(cloud: GridCloud, plane: Plane) -> NDArray[np.uint8]:
    """Return the (h, w) grid of what each pixel sees: nothing, the rim, something above it or in the bin."""
    heights = plane.heights(cloud.points_cam)
    tolerance = rim_tolerance(plane.noise)
    classes = np.full(len(heights), _NOTHING, np.uint8)
    classes[np.abs(heights) <= tolerance] = _RIM
    classes[heights > tolerance] = _ABOVE
    classes[heights < -LEAST_DEPTH] = _BELOW
    grid = np.zeros(cloud.shape, np.uint8)
    grid.ravel()[cloud.cells] = classes
    return grid


def rim_tolerance(noise: float) -> float:
    """Return the distance from the rim's plane up to which a point belongs to it [m]."""
    return max(3 * noise, 0.002)


def _frame_of(plane: Plane, x_cam: Floats) -> Floats:
    """Return the (4, 4) pose of a frame in the plane: z along its normal, x as near as possible to ``x_cam``."""
    x = x_cam - (x_cam @ plane.normal) * plane.normal
    x = x / np.linalg.norm(x)
    rotation = np.column_stack([x, np.cross(plane.normal, x), plane.normal])
    return make_transform(rotation, plane.offset * plane.normal)


def _rectangle(
    hole: NDArray[np.bool_], corner: tuple[int, int], cloud: GridCloud, plane: Plane, T_cam_plane: Floats
) -> Opening:
    """Return the rectangle around the cells of a hole, whose mask starts at column and row ``corner``."""
    contours, _ = cv2.findContours(hole.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = np.concatenate(contours)[:, 0] + np.array(corner)
    points = plane.meet(pixel_rays(cloud.K, outline * float(cloud.step)))
    flat = (points - T_cam_plane[:3, 3]) @ T_cam_plane[:3, :2]
    middle, size, degrees = cv2.minAreaRect(flat.astype(np.float32))
    quarters = np.round(degrees / 90)  # which side is the length is decided by the direction
    if quarters % 2:
        size = (size[1], size[0])
    angle = np.deg2rad(degrees - 90 * quarters)
    c, s = np.cos(angle), np.sin(angle)
    T_plane_opening = make_transform([[c, -s, 0], [s, c, 0], [0, 0, 1]], (*middle, 0.0))
    return Opening(T_cam_opening=T_cam_plane @ T_plane_opening, size=np.array(size, np.float64), rim=0.0)


def _with_rim(opening: Opening, seen: NDArray[np.uint8], cloud: GridCloud) -> Opening:
    """Return the opening with the share of its outline beside which the rim was measured."""
    pixel = cloud.step * float(opening.T_cam_opening[2, 3]) / float(cloud.K[0, 0])
    steps = np.linspace(-0.45, 0.45, 30)
    found = []
    for outside in (0.5, 1.5, 2.5):  # cells beside the outline; a rim may be thin
        half = opening.size / 2 + outside * pixel
        along, beside = steps[:, None] * opening.size, np.broadcast_to(half, (30, 2))
        sides = [np.column_stack([sign * beside[:, 0], along[:, 1]]) for sign in (-1, 1)] + [
            np.column_stack([along[:, 0], sign * beside[:, 1]]) for sign in (-1, 1)
        ]
        flat = np.concatenate(sides)
        points = flat @ opening.T_cam_opening[:3, :2].T + opening.T_cam_opening[:3, 3]
        uv = points @ cloud.K.T
        cells = np.rint(uv[:, :2] / uv[:, 2:] / cloud.step).astype(np.int64)
        inside = np.all((cells >= 0) & (cells < np.array(seen.shape)[::-1]), axis=1)
        cells = cells.clip(0, np.array(seen.shape)[::-1] - 1)
        found.append(inside & (seen[cells[:, 1], cells[:, 0]] == _RIM))
    share = float(np.mean(np.any(found, axis=0)))
    return Opening(T_cam_opening=opening.T_cam_opening, size=opening.size, rim=share)

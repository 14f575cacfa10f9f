"""Depth measurements on a coarse grid of pixels, and how well they fill a bin that is assumed to be somewhere."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.frame import Frame
from perception.geometry import (
    NEAR,
    Floats,
    invert_transform,
    pixel_rays,
    project_points,
    sampling_step,
    transform_points,
)

_MOST = 16_384  # number of pixels that are looked at; a share of them is exact to half a percent
_TOLERANCE = 0.015  # distance outside the box at which a point still counts as in it: rims, noise, an inexact pose [m]
_BELOW = 0.05  # depth below the floor down to which a point counts as in the box: the height may be wrong [m]
_HEADROOM = 0.03  # height above the rim up to which parts are heaped [m]
_SAME_HEIGHT = 0.002  # difference of heights that count as the same [m]
_TOP = 0.98  # share of the points in the box that lie below its contents' top
_FEWEST_SHOWN = 4  # number of samples below which the bin counts as out of view
_ODD_SHARE = 0.005  # share of the measurements from which one value that all others are far from is no distance
_ODD_RATIO = 1.5  # ratio of this value and the nearest other one


@dataclass(frozen=True, kw_only=True)
class BoxFit:
    """How well the measurements fill a bin that is assumed to be somewhere.

    Attributes:
        inside: Share of the measurements in the bin's image whose points lie in its box, in [0, 1].
        measured: Share of the pixels in the bin's image that have a depth, in [0, 1].
        view: Share of the bin's image that lies within the frame, in [0, 1].
        low: Height over the bin's floor below which a quarter of the points between its walls lie [m]; 0 without any.
        top: Height over the bin's floor below which nearly all of the points in its box lie [m]; 0 without any.
    """

    inside: float = 0.0
    measured: float = 0.0
    view: float = 0.0
    low: float = 0.0
    top: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthSamples:
    """Depth measurements on a coarse grid of pixels.

    Attributes:
        depth: (h, w) depth at every ``step``-th pixel [m], as the frame has it; 0 where there is no measurement.
        step: Distance of neighbouring pixels of the grid [px].
        size: Width and height of the image [px].
        missing: Value that stands for no measurement, but was taken for a depth [m]; None if there is none.
        missing_share: Share of the pixels that have this value, in [0, 1].
    """

    depth: NDArray[np.float32]
    step: int
    size: tuple[int, int]
    missing: float | None
    missing_share: float

    @classmethod
    def of(cls, frame: Frame) -> "DepthSamples":
        """Return the samples of a frame."""
        height, width = frame.depth.shape
        step = grid_step(frame.depth, _MOST)
        depth = frame.depth[::step, ::step]
        missing = _odd_value(depth[depth > 0])
        share = 0.0 if missing is None else float(np.mean(depth == np.float32(missing)))
        return cls(depth=depth, step=step, size=(width, height), missing=missing, missing_share=share)

    def measured(self, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return the mask of the depths that are measurements, of an array of any shape."""
        there = depth > 0
        return there if self.missing is None else there & (depth != np.float32(self.missing))

    def fit(self, K: Floats, T_cam_bin: Floats, inner_size: Floats, scale: float) -> BoxFit:
        """Return how well the measurements fill a bin; nothing is inside or in view where the camera looks elsewhere.

        Args:
            K: (3, 3) camera matrix [px].
            T_cam_bin: (4, 4) assumed pose of the bin in the camera frame.
            inner_size: (3,) inner length, width and height of the bin [m].
            scale: Factor from the frame's depth to metres.
        """
        half = inner_size[:2] / 2
        corners_bin = np.array(
            [[x, y, z] for x in (-half[0], half[0]) for y in (-half[1], half[1]) for z in (0.0, inner_size[2])]
        )
        corners_cam = transform_points(T_cam_bin, corners_bin)
        image, view = self._image_of(K, corners_cam)
        shown = int(np.count_nonzero(image))
        if shown < _FEWEST_SHOWN:
            return BoxFit()
        v, u = np.nonzero((image > 0) & self.measured(self.depth))
        if len(v) == 0:
            return BoxFit(view=view)
        z = self.depth[v, u].astype(np.float64) * scale
        rays = pixel_rays(K, np.column_stack([u, v]) * self.step)
        points_bin = transform_points(invert_transform(T_cam_bin), rays * z[:, None])
        beside, height = np.abs(points_bin[:, :2]).T, points_bin[:, 2]
        inside = (beside[0] <= half[0] + _TOLERANCE) & (beside[1] <= half[1] + _TOLERANCE)
        inside &= (height >= -_BELOW) & (height <= inner_size[2] + _HEADROOM)
        between = height[(beside[0] <= half[0]) & (beside[1] <= half[1])]
        low = float(np.quantile(between, 0.25)) if len(between) else 0.0
        top = float(np.quantile(height[inside], _TOP)) if inside.any() else 0.0
        return BoxFit(inside=float(np.mean(inside)), measured=len(v) / shown, view=view, low=low, top=top)

    def level(self, K: Floats, T_cam_bin: Floats, scale: float, *, along_rays: bool = False) -> float:
        """Return the share of pairs of measurements that are at the same height, to 2 mm; 0 without any.

        It is high where level surfaces such as floor, rim and table are in view, and their depths are what they are
        taken for.

        Args:
            K: (3, 3) camera matrix [px].
            T_cam_bin: (4, 4) assumed pose of the bin in the camera frame; its z axis points upwards.
            scale: Factor from the frame's depth to metres.
            along_rays: Whether a depth is taken for the distance from the camera's centre, along the ray of its pixel.
        """
        v, u = np.nonzero(self.measured(self.depth))
        if len(v) == 0:
            return 0.0
        rays = pixel_rays(K, np.column_stack([u, v]) * self.step)
        if along_rays:
            rays /= np.linalg.norm(rays, axis=1)[:, None]
        upwards = T_cam_bin[:3, 2]
        heights = (rays @ upwards) * (self.depth[v, u].astype(np.float64) * scale)
        _, counts = np.unique(np.floor(heights / _SAME_HEIGHT), return_counts=True)
        return float(np.sum((counts / len(v)) ** 2))

    def _image_of(self, K: Floats, corners_cam: Floats) -> tuple[NDArray[np.uint8], float]:
        """Return the (h, w) mask of the samples that show a box of (8, 3) corners, and the share of it in view."""
        image = np.zeros(self.depth.shape, np.uint8)
        behind = corners_cam[:, 2] <= NEAR
        if behind.all():
            return image, 0.0
        if behind.any():  # the camera looks from within the box
            return image + np.uint8(1), 1.0
        outline = cv2.convexHull((project_points(K, corners_cam) / self.step).clip(-1e4, 1e4).astype(np.float32))
        cv2.fillConvexPoly(image, np.rint(outline).astype(np.int32), 1)
        area = float(cv2.contourArea(outline))
        return image, min(np.count_nonzero(image) / max(area, 1.0), 1.0)


def grid_step(depth: NDArray[np.float32], most: int) -> int:
    """Return the distance of pixels with which an (H, W) depth image has about ``most`` samples [px].

    It is one larger where the samples would lie on lines of the image that are missing regularly.
    """
    step = sampling_step(depth.size, most)
    return step if depth[::step, ::step].any() else step + 1


def _odd_value(depths: NDArray[np.float32]) -> float | None:
    """Return the least or greatest of (N,) depths if many pixels have it exactly and all others are far from it."""
    if len(depths) == 0:
        return None
    for extreme, beyond in ((depths.max(), np.max), (depths.min(), np.min)):
        others = depths[depths != extreme]
        if len(others) == 0:
            return None
        nearest = float(beyond(others))
        ratio = max(float(extreme) / nearest, nearest / float(extreme))
        if ratio >= _ODD_RATIO and len(depths) - len(others) >= _ODD_SHARE * len(depths):
            return float(extreme)
    return None

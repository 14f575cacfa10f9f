"""A frame of a depth camera, and the bin that it shows."""

import logging
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from perception.geometry import (
    NEAR,
    Floats,
    as_floats,
    invert_transform,
    project_points,
    require_camera,
    require_rigid,
    require_shape,
    transform_points,
)

# Depth from which on a value stands for "no measurement", as the largest ones of 32-bit integers and floating point do
# [m]. Micrometres that are taken as metres stay below it, so that the wrong unit can be told.
FARTHEST = 1e6
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame:
    """One frame of a calibrated depth camera.

    Attributes:
        grey: (H, W) uint8 grey image, registered to the depth; zeros if it is left out or None, for a camera that
            takes none.
        depth: (H, W) float32 depth along the optical axis [m]; 0 where there is no measurement. Values that are not
            finite and positive, or at least `FARTHEST`, or masked, become 0.
        K: (3, 3) camera matrix [px] of this image, pixel centres at integers.
        T_world_cam: (4, 4) camera pose, OpenCV axes; a rotation and a translation.
    """

    grey: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0), np.uint8))
    depth: NDArray[np.float32]
    K: Floats
    T_world_cam: Floats

    def __post_init__(self) -> None:
        for name in ("K", "T_world_cam"):
            object.__setattr__(self, name, as_floats(name, getattr(self, name)))
        if isinstance(self.depth, np.ma.MaskedArray):
            object.__setattr__(self, "depth", self.depth.filled(0))
        for name in ("grey", "depth"):
            object.__setattr__(self, name, np.asarray(getattr(self, name)))
        if self.grey.ndim == 0 or self.grey.size == 0 < self.depth.size:  # None becomes an array without dimensions
            object.__setattr__(self, "grey", np.zeros(self.depth.shape, np.uint8))
        if self.depth.ndim != 2 or self.grey.shape != self.depth.shape:
            raise ValueError(
                f"grey and depth must have the same shape (H, W), got {self.grey.shape} and {self.depth.shape}"
            )
        if self.grey.dtype != np.uint8:
            raise ValueError(f"grey must be uint8, levels from 0 to 255, got {self.grey.dtype}: use astype(np.uint8)")
        if not np.issubdtype(self.depth.dtype, np.floating):
            raise ValueError(f"depth must be floating point metres, got {self.depth.dtype} (millimetres in integers?)")
        require_camera(self.K, self.depth.shape[1], self.depth.shape[0])
        require_rigid("T_world_cam", self.T_world_cam)
        object.__setattr__(self, "depth", _measured(self.depth))

    @property
    def has_grey(self) -> bool:
        """Whether the grey image shows anything, which it does unless all its pixels are alike."""
        return bool(self.grey.size and np.any(self.grey != self.grey.flat[0]))

    @cached_property
    def has_depth(self) -> bool:
        """Whether any pixel has a depth."""
        return bool(self.depth[::16, ::16].any() or self.depth.any())  # some pixels are nearly always enough

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) mask of the pixels that have a depth."""
        return self.depth > 0


def _measured(depth: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return (H, W) depths [m] with 0 in place of what is no distance; NaN fails both comparisons."""
    depth = depth if depth.itemsize >= 4 else depth.astype(np.float32)  # half precision ends before `FARTHEST`
    ahead = depth > 0
    near = ahead & (depth < FARTHEST)
    if not near.any() and (ahead & np.isfinite(depth)).any():
        _log.warning(
            "all depths are %.0e m or more and count as missing: is their unit the metre? Readers take scale "
            "(--depth-scale on the command line)",
            FARTHEST,
        )
    return np.where(near, depth, 0).astype(np.float32, copy=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class Workspace:
    """Pose and inner size of the bin. The origin of the bin frame is the centre of the inner floor, z up.

    Attributes:
        T_world_bin: (4, 4) pose of the bin; a rotation and a translation.
        inner_size: (3,) inner length, width and height of the bin along its x, y and z [m].
        translation_std: Standard deviation of the bin's position, as the camera sees it [m]; 0 if it is exact.
        rotation_std: Standard deviation of its orientation [rad]; 0 if it is exact.
    """

    T_world_bin: Floats
    inner_size: Floats
    translation_std: float = 0.0
    rotation_std: float = 0.0

    def __post_init__(self) -> None:
        for name in ("T_world_bin", "inner_size"):
            object.__setattr__(self, name, as_floats(name, getattr(self, name)))
        require_rigid("T_world_bin", self.T_world_bin)
        require_shape("inner_size", self.inner_size, (3,))
        if not np.all((self.inner_size > 0) & (self.inner_size < np.inf)):
            raise ValueError(f"inner_size must be positive and finite, got {self.inner_size.tolist()}")
        for name in ("translation_std", "rotation_std"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be 0 or more and finite, got {getattr(self, name)}")

    def std_at(self, point_world: Floats) -> float:
        """Return the standard deviation of the place of the bin's surfaces near a (3,) point [m]."""
        if self.translation_std == self.rotation_std == 0:
            return 0.0
        lever = float(np.linalg.norm(point_world - self.T_world_bin[:3, 3]))
        return float(np.hypot(self.translation_std, self.rotation_std * lever))

    def to_bin(self, points_world: Floats) -> Floats:
        """Map (N, 3) world points into the bin frame."""
        return transform_points(invert_transform(self.T_world_bin), points_world)

    def contains(
        self, points_world: Floats, *, margin: float = 0.0, headroom: float = 0.0, floor: float | None = None
    ) -> NDArray[np.bool_]:
        """Return the (N,) mask of world points inside the inner box.

        Args:
            points_world: (N, 3) points in the world frame [m].
            margin: Distance by which the box is shrunk at the walls and the floor [m].
            headroom: Height by which the box extends above the rim [m].
            floor: Distance by which the box is shrunk at the floor [m]; ``margin`` if None.
        """
        points_bin = self.to_bin(points_world)
        half = self.inner_size[:2] / 2 - margin
        beside = np.all(np.abs(points_bin[:, :2]) <= half, axis=1)
        z = points_bin[:, 2]
        lowest = margin if floor is None else floor
        inside: NDArray[np.bool_] = beside & (z >= lowest) & (z <= self.inner_size[2] + headroom)
        return inside


def bin_region(
    workspace: Workspace, K: Floats, T_world_cam: Floats, size: tuple[int, int], *, margin: float, headroom: float
) -> NDArray[np.int64]:
    """Return the rectangle of pixels that shows the bin: (4,) ``u0, v0, u1, v1``, empty if the bin is out of view.

    Args:
        workspace: Pose and size of the bin.
        K: (3, 3) camera matrix [px].
        T_world_cam: (4, 4) camera pose.
        size: Width and height of the image [px].
        margin: Width added on each side of the inner box, for the walls [m].
        headroom: Height added above the rim, for a heaped pile [m].
    """
    half = workspace.inner_size[:2] / 2 + margin
    top = workspace.inner_size[2] + headroom
    corners_bin = np.array([[x, y, z] for x in (-half[0], half[0]) for y in (-half[1], half[1]) for z in (0.0, top)])
    T_cam_bin = invert_transform(T_world_cam) @ workspace.T_world_bin
    corners_cam = transform_points(T_cam_bin, corners_bin)
    behind = corners_cam[:, 2] <= NEAR
    if behind.all():
        return np.zeros(4, np.int64)
    if behind.any():
        return np.array([0, 0, *size], np.int64)
    pixels = project_points(K, corners_cam)
    low = np.clip(np.floor(pixels.min(axis=0)), 0, size)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 1, low, size)
    return np.array([*low, *high], np.int64)

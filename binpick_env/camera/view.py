"""Input and output of a camera backend: a view of posed geoms, and the first surface behind each pixel."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, invert_transform, transform_points

VISIBLE = 2  # geom group that cameras see


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """Camera and poses of the geoms in front of it.

    Attributes:
        K: (3, 3) pinhole matrix [px].
        width: Width of the image [px].
        height: Height of the image [px].
        region: (4,) int64 half-open rectangle ``u0, v0, u1, v1`` of the pixels to fill.
        rotations: (ngeom, 3, 3) geom axes in the camera frame.
        positions: (ngeom, 3) geom origins in the camera frame [m].
    """

    K: Floats
    width: int
    height: int
    region: NDArray[np.int64]
    rotations: Floats
    positions: Floats

    def slopes(self) -> tuple[Floats, Floats]:
        """Return the coordinates at depth 1 of the image's columns, (W,) float64, and of its rows, (H,)."""
        return pixel_slopes(self.K, self.width, self.height)


@dataclass(frozen=True, eq=False, kw_only=True)
class Hits:
    """The first surface behind every pixel.

    Attributes:
        depth: (H, W) float64 along the optical axis [m], 0 where there is nothing.
        geom_at: (H, W) int32 geom of the model, -1 where there is nothing.
        normals: (H, W, 3) float32 unit surface normals in the camera frame, towards the eye; 0 where there is nothing.
    """

    depth: Floats
    geom_at: NDArray[np.int32]
    normals: NDArray[np.float32]

    @classmethod
    def empty(cls, view: View) -> "Hits":
        """Return arrays in which there is nothing behind any pixel, for a backend to fill."""
        size = (view.height, view.width)
        return cls(depth=np.zeros(size), geom_at=np.full(size, -1, np.int32), normals=np.zeros((*size, 3), np.float32))


def pixel_slopes(K: Floats, width: int, height: int) -> tuple[Floats, Floats]:
    """Return the coordinates at depth 1 of an image's columns, (W,) float64, and of its rows, (H,).

    Args:
        K: (3, 3) pinhole matrix [px].
        width: Width of the image [px].
        height: Height of the image [px].
    """
    return (np.arange(width) - K[0, 2]) / K[0, 0], (np.arange(height) - K[1, 2]) / K[1, 1]


def visible_geoms(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the ids of the geoms that cameras see: in the visible group, and not fully transparent."""
    material = model.geom_matid
    alpha = np.where(material >= 0, model.mat_rgba[material, 3] if model.nmat else 1.0, model.geom_rgba[:, 3])
    return np.nonzero((model.geom_group == VISIBLE) & (alpha > 0))[0].astype(np.int64)


def geoms_in_camera(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64], T_world_cam: Floats
) -> tuple[Floats, Floats]:
    """Return all geoms' rotations (ngeom, 3, 3) and positions (ngeom, 3) in the camera frame.

    Raises:
        ValueError: If the pose of one of ``geoms`` is not finite.
    """
    rotations_world = data.geom_xmat.reshape(-1, 3, 3)
    finite = np.isfinite(data.geom_xpos).all(axis=1) & np.isfinite(rotations_world).all(axis=(1, 2))
    bad = geoms[~finite[geoms]]
    if len(bad):
        body = model.body(model.geom_bodyid[bad[0]]).name
        raise ValueError(f"the pose of body {body!r} is not finite; the simulation has diverged")
    T_cam_world = invert_transform(T_world_cam)
    return T_cam_world[:3, :3] @ rotations_world, transform_points(T_cam_world, data.geom_xpos)

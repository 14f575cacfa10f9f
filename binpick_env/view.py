"""What a camera backend is asked for, and what it answers."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from perception.frame import Workspace
from perception.geometry import Floats, invert_transform, project_points, transform_points

VISIBLE = 2  # the geom group that cameras see
NEAR = 1e-3  # [m]; nothing nearer to the camera is seen


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """One look at posed geoms.

    Attributes:
        K: (3, 3) pinhole matrix [px].
        width: Of the image [px].
        height: Of the image [px].
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
        """Return hits of nothing, to be filled by a backend."""
        size = (view.height, view.width)
        return cls(depth=np.zeros(size), geom_at=np.full(size, -1, np.int32), normals=np.zeros((*size, 3), np.float32))


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


def bin_region(
    workspace: Workspace, K: Floats, T_world_cam: Floats, size: tuple[int, int], *, margin: float, headroom: float
) -> NDArray[np.int64]:
    """Return the rectangle (4,) ``u0, v0, u1, v1`` of pixels that show the bin with its walls; empty if out of view.

    Args:
        workspace: The bin.
        K: (3, 3) pinhole matrix.
        T_world_cam: (4, 4).
        size: Width and height of the image [px].
        margin: Added beside the inner box, for the walls [m].
        headroom: Added above the rim, for a heaped pile [m].
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

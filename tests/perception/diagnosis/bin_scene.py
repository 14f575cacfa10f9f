"""One good frame of a simple scene, ray by ray: blocks that lie in a bin on a table, under a tilted camera."""

from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from perception.boundary import BoundaryCloud
from perception.frame import Frame, Workspace
from perception.geometry import (
    Floats,
    camera_matrix,
    deproject_depth,
    make_transform,
    rotation_about,
    transform_points,
)
from perception.instance import Instance
from tests.perception.pose import observed_part as at

SIZE = (480, 360)
K = camera_matrix(720.0, *SIZE)
WALL, TABLE = 0.008, 0.05  # thickness of the walls, and height of the bin's floor over the table [m]
BIN = Workspace(
    T_world_bin=make_transform(rotation_about((0, 0, 1), 0.3), (0.55, 0.12, 0.07)),
    inner_size=np.array([0.24, 0.18, 0.08]),
)
ELL = at.ell()
_TILT = make_transform(rotation_about((1, 0.4, 0), 0.2))
T_WORLD_CAM = BIN.T_world_bin @ _TILT @ make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 0.6))


def lying(x: float, y: float, angle: float) -> Floats:
    """Return the pose in the world of a block on the floor of the bin, (x, y) its centre in the bin."""
    R = rotation_about((0, 0, 1), angle)
    return BIN.T_world_bin @ make_transform(R, np.array([x, y, at.HEIGHT / 2]) - R @ ELL.centre)


POSES = tuple(
    lying(x, y, a) for x, y, a in [(-0.07, 0.04, 0.3), (0.02, 0.045, 1.9), (0.075, -0.02, 3.7), (-0.03, -0.045, 5.1)]
)


@cache
def good() -> tuple[Frame, NDArray[np.int64]]:
    """Return the frame, and the (H, W) block that each pixel shows, -1 for none."""
    boxes = [((2.0, 2.0, 0.02), (0.0, 0.0, -TABLE - 0.01)), ((0.24, 0.18, WALL), (0.0, 0.0, -WALL / 2))]
    for side in (-1, 1):
        boxes.append(((WALL, 0.18 + 2 * WALL, 0.08), (side * (0.24 + WALL) / 2, 0.0, 0.04)))
        boxes.append(((0.24 + 2 * WALL, WALL, 0.08), (0.0, side * (0.18 + WALL) / 2, 0.04)))
    solids = [trimesh.creation.box(size, BIN.T_world_bin @ make_transform(translation=place)) for size, place in boxes]
    solids += [ELL.mesh.copy().apply_transform(T) for T in POSES]
    owner_of_face = np.concatenate([np.full(len(each.faces), max(k - len(boxes), -1)) for k, each in enumerate(solids)])
    scene = trimesh.util.concatenate(solids)
    v, u = (a.ravel() for a in np.indices((SIZE[1], SIZE[0])))
    rays_cam = np.column_stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.size)])
    rays, eye = rays_cam @ T_WORLD_CAM[:3, :3].T, T_WORLD_CAM[:3, 3]
    face = scene.ray.intersects_first(np.broadcast_to(eye, rays.shape), rays)
    normal = scene.face_normals[face]
    z = np.einsum("ni,ni->n", normal, scene.triangles[face, 0] - eye) / np.einsum("ni,ni->n", normal, rays)
    z += 0.0002 * np.random.default_rng(0).normal(size=z.size)
    shades = np.clip(140 + 90 * normal @ np.array([0.7, 0.4, 0.3]), 90, 240)
    owner = np.where(face >= 0, owner_of_face[face], -1)
    grey = np.where(owner >= 0, shades, 60.0).astype(np.uint8)
    shape = SIZE[1], SIZE[0]
    depth = z.reshape(shape).astype(np.float32)
    depth[:, :6] = 0.0  # as beside the projector's field of view
    return Frame(grey=grey.reshape(shape), depth=depth, K=K, T_world_cam=T_WORLD_CAM), owner.reshape(shape)


def true_groups(boundary: BoundaryCloud) -> list[Instance]:
    """Return the boundary points of each block."""
    owner = good()[1][boundary.pixels[:, 1], boundary.pixels[:, 0]]
    groups = [np.flatnonzero(owner == k) for k in range(len(POSES))]
    return [Instance(point_idx=each, score=0.9) for each in groups if len(each) >= 30]


def in_bin() -> NDArray[np.bool_]:
    """Return the (H, W) mask of the pixels that show the bin's inside or its walls."""
    frame = good()[0]
    points_cam = deproject_depth(K, frame.depth).reshape(-1, 3)
    return BIN.contains(transform_points(T_WORLD_CAM, points_cam), margin=-0.01, headroom=0.01).reshape(
        frame.depth.shape
    )

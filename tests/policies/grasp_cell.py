"""A bin with boxes in it, rendered from above by exact rays: frames whose every height is known."""

import numpy as np
import trimesh

from binpick_env.candidates import PoseCandidate
from perception.frame import Frame, Workspace
from perception.geometry import camera_matrix, invert_transform, make_transform, rotation_about

WALL = 0.02


def workspace(yaw=0.0, position=(0.5, 0.1), inner_size=(0.36, 0.26, 0.12)):
    T_world_bin = make_transform(rotation_about((0, 0, 1), yaw), (*position, WALL))
    return Workspace(T_world_bin=T_world_bin, inner_size=np.array(inner_size))


def box(extents, T_bin_box=None):
    return trimesh.creation.box(extents=extents, transform=T_bin_box)


def placed(x, y, z, yaw=0.0):
    return make_transform(rotation_about((0, 0, 1), yaw), (x, y, z))


def look(cell, meshes_bin, *, width=640, height=480, walls=True):
    """Return the frame of a camera 0.9 m above the bin's floor that points straight down, axes along the bin's."""
    length, across, rim = cell.inner_size
    solids = [box((length + 2 * WALL, across + 2 * WALL, WALL), placed(0, 0, -WALL / 2)), *meshes_bin]
    if walls:
        for side in (-1, 1):
            solids.append(box((WALL, across + 2 * WALL, rim), placed(side * (length + WALL) / 2, 0, rim / 2)))
            solids.append(box((length + 2 * WALL, WALL, rim), placed(0, side * (across + WALL) / 2, rim / 2)))
    scene = trimesh.util.concatenate(solids)
    K = camera_matrix(1.875 * width, width, height)
    T_bin_cam = make_transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 0.9))
    v, u = np.mgrid[:height, :width]
    rays_cam = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1).reshape(-1, 3)
    rays = rays_cam @ T_bin_cam[:3, :3].T
    origins = np.broadcast_to(T_bin_cam[:3, 3], rays.shape)
    face = scene.ray.intersects_first(origins, rays)
    normal = scene.face_normals[face]
    ahead = np.einsum("ni,ni->n", normal, scene.triangles[face, 0] - origins)
    depth = np.where(face >= 0, ahead / np.einsum("ni,ni->n", normal, rays), 0.0)
    return Frame(
        grey=np.zeros((height, width), np.uint8),
        depth=depth.reshape(height, width).astype(np.float32),
        K=K,
        T_world_cam=cell.T_world_bin @ T_bin_cam,
    )


def candidate(cell, mesh, T_bin_part, **changes):
    T_world_part = cell.T_world_bin @ T_bin_part
    top = float((mesh.vertices @ T_bin_part[:3, :3].T + T_bin_part[:3, 3])[:, 2].max())
    facts = {"score": 1.0, "visible_fraction": 1.0, "top": top, "fill": 1.0}
    return PoseCandidate(T_world_part=T_world_part, centre_world=T_world_part[:3, 3], **{**facts, **changes})


def in_bin(cell, T_world_a):
    return invert_transform(cell.T_world_bin) @ T_world_a

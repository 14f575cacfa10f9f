"""Frames worked out by hand: painted rectangles seen through a pinhole, ray by ray."""

from dataclasses import dataclass

import numpy as np

from perception.frame import Frame, Workspace
from perception.geometry import Floats, camera_matrix, invert_transform, make_transform, rotation_about

SIZE = (320, 240)
K = camera_matrix(520.0, *SIZE) + np.array([[0.0, 0.0, 7.0], [0.0, 15.0, -5.0], [0.0, 0.0, 0.0]])  # no symmetry
INNER = np.array([0.36, 0.26, 0.12])
TILTED = make_transform(rotation_about((1, 0, 0), 0.12)) @ make_transform(rotation_about((0, 1, 0), -0.09))


@dataclass(frozen=True, eq=False, kw_only=True)
class Plate:
    """A rectangle of one grey in the x-y plane of its own frame, centred on its origin."""

    T_bin_plate: Floats
    size: tuple[float, float]
    grey: int = 200


def flat(x: float, y: float, z: float, size: tuple[float, float], grey: int = 200) -> Plate:
    """Return a plate parallel to the bin's floor."""
    return Plate(T_bin_plate=make_transform(translation=(x, y, z)), size=size, grey=grey)


FLOOR = flat(0, 0, 0, (9.0, 9.0), 60)


def bin_at(yaw: float = 0.0, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Workspace:
    """Return the standard bin."""
    return Workspace(T_world_bin=make_transform(rotation_about((0, 0, 1), yaw), position), inner_size=INNER)


def camera_over(workspace: Workspace, turn: Floats | None = None, distance: float = 0.9) -> Floats:
    """Return ``T_world_cam``: straight above the bin, image x along the bin's x, then turned about the bin's origin."""
    above = make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, distance))
    return workspace.T_world_bin @ (np.eye(4) if turn is None else turn) @ above


def look(workspace: Workspace, T_world_cam: Floats, *plates: Plate) -> Frame:
    """Return what an ideal camera sees of the plates: for each pixel's ray the nearest one that it meets."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    rays_cam = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    depth, grey = np.full(u.shape, np.inf), np.zeros(u.shape, np.uint8)
    for plate in plates:
        T_plate_cam = invert_transform(workspace.T_world_bin @ plate.T_bin_plate) @ T_world_cam
        rays, eye = rays_cam @ T_plate_cam[:3, :3].T, T_plate_cam[:3, 3]
        t = -eye[2] / np.where(rays[..., 2] == 0, 1e-12, rays[..., 2])
        hit = eye[:2] + t[..., None] * rays[..., :2]
        nearer = (np.abs(hit) <= np.array(plate.size) / 2).all(axis=-1) & (t > 0) & (t < depth)
        depth[nearer], grey[nearer] = t[nearer], plate.grey
    depth[np.isinf(depth)] = 0.0
    return Frame(grey=grey, depth=depth.astype(np.float32), K=K, T_world_cam=T_world_cam)

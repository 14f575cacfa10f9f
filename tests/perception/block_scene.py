"""Two blocks in a bin, ray-cast, and a predictor that knows which boundary points are whose."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from perception.boundary import BoundaryCloud
from perception.frame import Frame, Workspace
from perception.geometry import Floats, make_transform, rotation_about, transform_points
from perception.instance import Instance
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.surface import Surface
from tests.perception.pose import observed_part as at

ELL = at.ell()
ON_BLOCK = trimesh.sample.sample_surface(ELL.mesh, 20_000, seed=0)[0]
OVER = rotation_about((1.0, 0.0, 0.0), np.pi)
BIN = Workspace(T_world_bin=make_transform(OVER, (0.0, 0.0, at.FLOOR)), inner_size=np.array([0.4, 0.3, 0.1]))


def lying(x: float, y: float, angle: float) -> Floats:
    """Return the pose of a block on the bin's floor."""
    rotation = rotation_about((0.0, 0.0, 1.0), angle) @ rotation_about((1.0, 0.3, 0.0), 0.35) @ OVER
    return make_transform(rotation, np.array([x, y, at.FLOOR - 0.025]) - rotation @ ELL.centre)


POSES = lying(-0.027, 0.0, 1.45), lying(0.025, 0.0, 4.6)


def photographed(*poses: Floats) -> Frame:
    """Return the depth of blocks in the bin, and their grey by how they are turned to the light."""
    frame = at.look_at(*(at.placed(ELL, T) for T in poses), noise=0.0002)
    grey = np.full(frame.grey.shape, 60, np.uint8)
    if poses:
        mesh = trimesh.util.concatenate([at.placed(ELL, T) for T in poses])
        v, u = (a.ravel() for a in np.indices(grey.shape))
        rays = np.column_stack([(u - at.K[0, 2]) / at.K[0, 0], (v - at.K[1, 2]) / at.K[1, 1], np.ones(u.size)])
        face = mesh.ray.intersects_first(np.zeros_like(rays), rays).reshape(grey.shape)
        shades = np.clip(150 + 100 * mesh.face_normals @ np.array([0.8, 0.5, -0.3]), 90, 250)
        grey[face >= 0] = shades[face[face >= 0]].astype(np.uint8)
    return replace(frame, grey=grey)


def owners(boundary: BoundaryCloud, *poses: Floats) -> np.ndarray:
    """Return (N,) the block that each boundary point lies on, -1 for none."""
    gaps = [cKDTree(transform_points(T, ON_BLOCK)).query(boundary.points_cam)[0] for T in poses]
    return np.where(np.min(gaps, axis=0) < 0.003, np.argmin(gaps, axis=0), -1)


class KnowingPredictor(SegmentationPredictor):
    """Gives the groups that it was told, and keeps what it was asked."""

    needs_surface = True  # type: ignore[assignment]

    def __init__(self, groups: Callable[[BoundaryCloud], list[Instance]]) -> None:
        self.groups = groups
        self.asked: list[tuple[BoundaryCloud, Surface, float]] = []

    def predict(self, boundary: BoundaryCloud, surface: Surface, d_max: float) -> list[Instance]:
        self.asked.append((boundary, surface, d_max))
        return self.groups(boundary) if len(boundary) else []


def true_groups(boundary: BoundaryCloud) -> list[Instance]:
    owner = owners(boundary, *POSES)
    return [Instance(point_idx=np.flatnonzero(owner == k), score=0.9 - 0.1 * k) for k in range(len(POSES))]


def one_group(boundary: BoundaryCloud) -> list[Instance]:
    return [Instance(point_idx=np.arange(len(boundary)), score=0.9)]

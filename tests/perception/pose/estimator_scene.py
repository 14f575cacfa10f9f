"""Scenes whose poses are known: the wires of blocks that a camera sees, and its depth image."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from perception.boundary import BoundaryCloud
from perception.frame import Frame
from perception.geometry import Floats, project_points
from perception.instance import Instance
from perception.part import PartModel
from perception.pose import estimator
from perception.pose.estimator import PoseEstimator
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model import appearances
from perception.pose.verification.confidence import ConfidenceConfig
from perception.pose.verification.verification import VerificationConfig
from tests.perception.pose import observed_part as at

# What comes with the package is fitted and may change; what is tested with these numbers may not.
RANKING = VerificationConfig(
    bias=-10.0, edge_weight=4.0, explained_weight=8.0, support_weight=4.0, violation_weight=-15.0
)
SURENESS = ConfidenceConfig(
    bias=-4.0,
    edge_score=6.0,
    support=5.0,
    violation=-15.0,
    margin=0.0,
    close_margin=0.0,
    score_drop=0.0,
    close_score_drop=0.0,
    size=0.0,
)
CONFIG = EstimatorConfig(
    verification=RANKING, confidence=SURENESS, hypotheses=4, most_hypotheses=12, sure=0.9, finalists=1, min_score=0.5
)


def quick_estimator(part: PartModel, config: EstimatorConfig = CONFIG) -> PoseEstimator:
    """Return an estimator of a part of straight edges: 162 views of it are enough, and made in no time."""
    made = estimator.edge_appearances
    estimator.edge_appearances = lambda part, config: appearances.edge_appearances(part, config, subdivisions=2)
    try:
        return PoseEstimator(part, config)
    finally:
        estimator.edge_appearances = made


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """A boundary cloud, whose point ``i`` is one of block ``owner[i]`` or of none (-1), and its frame."""

    boundary: BoundaryCloud
    owner: NDArray[np.int64]
    frame: Frame

    def groups(self) -> list[Instance]:
        """Return the true segments."""
        return [Instance(point_idx=np.flatnonzero(self.owner == k), score=1.0) for k in range(self.owner.max() + 1)]

    def only(self, chosen: NDArray[np.bool_]) -> "Scene":
        """Return the scene with some of the boundary points."""
        return Scene(boundary=self.boundary.only(chosen), owner=self.owner[chosen], frame=self.frame)


def scene_of(
    part: PartModel,
    *poses: Floats,
    hiders: Sequence[trimesh.Trimesh] = (),
    seed: int = 0,
    noise: float = at.SIGMA,
    clutter: int = 0,
) -> Scene:
    """Return what a camera sees of a part in each pose; ``clutter`` points lie anywhere about the first one."""
    rng = np.random.default_rng(seed)
    meshes = [*(at.placed(part, T) for T in poses), *hiders]
    points, tangents, owner = [], [], []
    for k, T in enumerate(poses):
        wire, along = at.wire_scene(T, part, rng)
        seen = unoccluded(wire, meshes)
        points.append(wire[seen] + noise * rng.normal(size=(np.count_nonzero(seen), 3)))
        tangents.append(along[seen])
        owner.append(np.full(len(points[-1]), k))
    if clutter:
        points.append(points[0].mean(axis=0) + part.d_max * rng.uniform(-0.6, 0.6, (clutter, 3)))
        directions = rng.normal(size=(clutter, 3))
        tangents.append(directions / np.linalg.norm(directions, axis=1, keepdims=True))
        owner.append(np.full(clutter, -1))
    return Scene(
        boundary=cloud(np.concatenate(points), np.concatenate(tangents)),
        owner=np.concatenate(owner),
        frame=at.look_at(*meshes, noise=noise),
    )


def unoccluded(points_cam: Floats, meshes_cam: Sequence[trimesh.Trimesh]) -> NDArray[np.bool_]:
    """Return (N,) whether a ray from a point to the camera meets no mesh."""
    towards = -points_cam / np.linalg.norm(points_cam, axis=1, keepdims=True)
    free: NDArray[np.bool_] = ~trimesh.util.concatenate(list(meshes_cam)).ray.intersects_any(
        points_cam + 0.0002 * towards, towards
    )
    return free


def cloud(points_cam: Floats, tangents_cam: Floats) -> BoundaryCloud:
    """Return boundary points; nothing here asks for their linearity."""
    return BoundaryCloud(
        points_cam=points_cam,
        tangents_cam=tangents_cam,
        linearity=np.ones(len(points_cam)),
        pixels=np.round(project_points(at.K, points_cam)).astype(np.int64)
        if len(points_cam)
        else np.zeros((0, 2), int),
    )

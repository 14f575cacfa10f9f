"""Inputs of the pose benchmark: segments and whole bins, as boundary points and as surface points with normals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from binpick_env.scenes.synthesis import CapturedScene, SceneConfig, make_scene
from binpick_env.scenes.whole_part import whole_part_points
from perception.boundary import BoundaryCloud, BoundarySettings
from perception.frame import Frame, Workspace
from perception.geometry import Floats, deproject_depth, require_shape, transform_points
from perception.instance import Instance
from perception.metrics.pose_recognition import visible_enough
from perception.part import PartModel
from perception.pose.candidates import nearest_groups
from perception.pose.model.surface_models import surface_model
from perception.segmentation.grouping.similarity import GroupingConfig

MODEL_SPACING = 0.012  # spacing of model points, as a share of d_max: some ten thousand points
NEIGHBOURS = 60  # points behind a normal, whose median error is 3 deg with the sensor preset "good"
_BLOCK = 20_000  # number of normals computed at once


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneInput:
    """One scene as our own method is given it."""

    boundary: BoundaryCloud
    frame: Frame


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseCase:
    """One search for the part, with its true poses.

    Attributes:
        scene: Index of the scene among the scene inputs.
        instance: True segment; None if a whole bin is searched.
        points: (N, 6) measured surface points [m] with unit normals, camera frame; the input of the peers.
        T_cam_parts: (P, 4, 4) true poses; each of them counts as right.
        to_find: (P,) bool, whether the part has to be found.
        top: Number of poses that a method may return.
    """

    scene: int
    instance: Instance | None
    points: Floats
    T_cam_parts: Floats
    to_find: NDArray[np.bool_]
    top: int

    def __post_init__(self) -> None:
        require_shape("points", self.points, (None, 6))
        require_shape("T_cam_parts", self.T_cam_parts, (None, 4, 4))
        require_shape("to_find", self.to_find, (len(self.T_cam_parts),))
        if self.top < 1 or len(self.T_cam_parts) == 0:
            raise ValueError(f"top and parts must be at least 1, got {self.top} and {len(self.T_cam_parts)}")


def model_points(part: PartModel) -> Floats:
    """Return (M, 6) points on the mesh [m] with unit normals, part frame."""
    model = surface_model(part, MODEL_SPACING)
    return np.hstack([model.points, model.normals])


def pose_cases(config: SceneConfig, count: int, whole_scenes: int) -> tuple[list[SceneInput], list[PoseCase]]:
    """Return ``count`` scenes and the cases in them: all segments, then the first scenes as a whole.

    The segments are the true ones of a recognition trial: the three of each scene whose sizes are nearest to P. For the
    peers a segment is every pixel of the true part that has a depth, which no segmentation would give them; our method
    is given only the boundary points among them.

    Args:
        config: Part and its scenes.
        count: Number of scenes.
        whole_scenes: Number of scenes that are also searched as a whole.

    Raises:
        ValueError: There is no such part, or a number is out of range.
    """
    if count < 1 or not 0 <= whole_scenes <= count:
        raise ValueError(f"count must be at least 1 and whole_scenes from 0 to it, got {count} and {whole_scenes}")
    expected = whole_part_points(config.part, config.unit, config.camera)
    scenes, segments, wholes = [], [], []
    for k in range(count):
        made = make_scene(config, k)
        scenes.append(SceneInput(boundary=made.scene.boundary, frame=made.capture.frame))
        segments += segment_cases(made, k, expected)
        if k < whole_scenes:
            wholes.append(whole_case(made, k, config.cell().bin.workspace()))
    return scenes, segments + wholes


def segment_cases(made: CapturedScene, index: int, expected: float) -> list[PoseCase]:
    """Return a case for each of the three true segments whose sizes are nearest to P.

    Args:
        made: Scene with its capture.
        index: Index of the scene.
        expected: P times depth [m].
    """
    scene, capture = made.scene, made.capture
    parts, sizes = np.unique(scene.instance_ids[scene.instance_ids >= 0], return_counts=True)
    large = sizes >= GroupingConfig().min_points
    parts, sizes = parts[large], sizes[large]
    if len(parts) == 0:
        return []
    nearest = max(round(expected / float(np.median(scene.boundary.points_cam[:, 2]))), 1)
    chosen: Sequence[int] = [int(parts[k]) for k in nearest_groups(sizes.tolist(), nearest)]
    cloud = deproject_depth(capture.frame.K, capture.frame.depth)
    return [
        PoseCase(
            scene=index,
            instance=Instance(point_idx=np.flatnonzero(scene.instance_ids == i), score=1.0),
            points=with_normals(cloud[capture.frame.valid & (capture.instance_ids == i)]),
            T_cam_parts=scene.T_cam_parts[i : i + 1],
            to_find=np.ones(1, np.bool_),
            top=1,
        )
        for i in chosen
    ]


def whole_case(made: CapturedScene, index: int, workspace: Workspace) -> PoseCase:
    """Return the case of a whole bin without the container; a method may return one pose per part in the bin."""
    scene, frame = made.scene, made.capture.frame
    points = deproject_depth(frame.K, frame.depth)[frame.valid]
    limits = BoundarySettings()
    inside = workspace.contains(
        transform_points(frame.T_world_cam, points), margin=limits.margin, headroom=limits.headroom
    )
    return PoseCase(
        scene=index,
        instance=None,
        points=with_normals(points[inside]),
        T_cam_parts=scene.T_cam_parts,
        to_find=visible_enough(scene.visible_fractions),
        top=len(scene.T_cam_parts),
    )


def with_normals(points: Floats) -> Floats:
    """Return (N, 6): the (N, 3) points [m] with unit normals towards the camera, of planes fitted to neighbours."""
    require_shape("points", points, (None, 3))
    if len(points) < 3:
        raise ValueError(f"a plane needs at least 3 points, got {len(points)}")
    tree, near = cKDTree(points), min(NEIGHBOURS, len(points))
    blocks = []
    for start in range(0, len(points), _BLOCK):
        around = points[tree.query(points[start : start + _BLOCK], k=near)[1]]
        around = around - around.mean(axis=1, keepdims=True)
        spread = np.swapaxes(around, 1, 2) @ around
        blocks.append(np.linalg.eigh(spread)[1][:, :, 0])
    normals = np.concatenate(blocks)
    away = np.einsum("ni,ni->n", normals, points) > 0
    normals[away] *= -1
    return np.hstack([points, normals])

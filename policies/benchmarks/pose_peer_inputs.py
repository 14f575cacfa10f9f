"""What all methods of the pose benchmark are given: segments and whole bins, as boundary points and as surfaces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from binpick_env.config import CellConfig
from binpick_env.scenes.synthesis import CapturedScene, SceneConfig, make_scene
from binpick_env.scenes.whole_part import whole_part_points
from perception.boundary import BoundaryCloud, BoundarySettings
from perception.frame import Frame
from perception.geometry import Floats, deproject_depth, require_shape, transform_points
from perception.instance import Instance
from perception.metrics.pose_recognition import visible_enough
from perception.part import PartModel
from perception.pose.candidates import nearest_groups
from perception.pose.model.surface_models import surface_model
from perception.segmentation.grouping.similarity import GroupingConfig

MODEL_SPACING = 0.012  # of d_max: some ten thousand points
NEIGHBOURS = 60  # of a normal; with a good sensor it is off by 3 deg at the median
_BLOCK = 20_000  # normals computed at once


@dataclass(frozen=True, eq=False, kw_only=True)
class Sight:
    """What our own method looks at."""

    boundary: BoundaryCloud
    frame: Frame


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseCase:
    """One search.

    Attributes:
        sight: Index of its scene among the sights.
        instance: The true segment; None where a whole bin is searched.
        points: (N, 6) measured surface points [m] and unit normals, camera frame: what the peers are given.
        T_cam_parts: (P, 4, 4) true poses, each of which is right.
        to_find: (P,) bool which of them have to be found.
        top: Number of poses that are asked for.
    """

    sight: int
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


def pose_cases(part: str, seed: int, count: int, whole_scenes: int) -> tuple[list[Sight], list[PoseCase]]:
    """Return the sights of ``count`` scenes and the cases: first all segments, then the first scenes as a whole.

    The segments are the true ones of a recognition trial: the three nearest to P of each scene. For the peers a
    segment is every pixel of the true part that has a depth, which no segmentation would give them; ours gets only
    the boundary points among them.

    Args:
        part: Catalogue name or mesh file.
        seed: Of the scenes.
        count: Number of scenes.
        whole_scenes: How many of them are searched as a whole, too.

    Raises:
        ValueError: There is no such part, or a number is out of range.
    """
    if count < 1 or not 0 <= whole_scenes <= count:
        raise ValueError(f"count must be at least 1 and whole_scenes from 0 to it, got {count} and {whole_scenes}")
    config = SceneConfig(part=part, seed=seed)
    expected = whole_part_points(part, None, config.camera)
    sights, segments, wholes = [], [], []
    for k in range(count):
        made = make_scene(config, k)
        sights.append(Sight(boundary=made.scene.boundary, frame=made.capture.frame))
        segments += segment_cases(made, k, expected)
        if k < whole_scenes:
            wholes.append(whole_case(made, k))
    return sights, segments + wholes


def segment_cases(made: CapturedScene, sight: int, expected: float) -> list[PoseCase]:
    """Return a case for each of the three true segments nearest to P; ``expected`` is P times depth [m]."""
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
            sight=sight,
            instance=Instance(point_idx=np.flatnonzero(scene.instance_ids == i), score=1.0),
            points=with_normals(cloud[capture.frame.valid & (capture.instance_ids == i)]),
            T_cam_parts=scene.T_cam_parts[i : i + 1],
            to_find=np.ones(1, np.bool_),
            top=1,
        )
        for i in chosen
    ]


def whole_case(made: CapturedScene, sight: int) -> PoseCase:
    """Return the case of a whole bin, container removed; as many poses are asked for as parts lie in it."""
    scene, frame = made.scene, made.capture.frame
    points = deproject_depth(frame.K, frame.depth)[frame.valid]
    limits = BoundarySettings()
    inside = (
        CellConfig()
        .bin.workspace()
        .contains(transform_points(frame.T_world_cam, points), margin=limits.margin, headroom=limits.headroom)
    )
    return PoseCase(
        sight=sight,
        instance=None,
        points=with_normals(points[inside]),
        T_cam_parts=scene.T_cam_parts,
        to_find=visible_enough(scene.visible_fractions),
        top=len(scene.T_cam_parts),
    )


def with_normals(points: Floats) -> Floats:
    """Return (N, 6): the (N, 3) points [m] and the normals of planes through their neighbours, towards the camera."""
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

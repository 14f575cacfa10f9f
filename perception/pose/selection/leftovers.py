"""Points of a group that its pose leaves over: another part that the segmentation merged with the first one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.boundary import BoundaryCloud
from perception.instance import Instance
from perception.pose.model.surface_models import SurfaceModel
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.explanation import ExplanationConfig, claimed_points


@dataclass(frozen=True, kw_only=True)
class LeftoverConfig:
    """When the points that the poses leave over are searched for another part.

    Attributes:
        min_score: Least score of a pose that takes its points away, in [0, 1].
        min_share: Least share of a group's points that is left over.
        min_points: Least number of points that are left over.
    """

    min_score: float = 0.5
    min_share: float = 0.2
    min_points: int = 90

    def __post_init__(self) -> None:
        for name in ("min_score", "min_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        if self.min_points < 1:
            raise ValueError(f"min_points must be at least 1, got {self.min_points}")


def leftover_groups(
    boundary: BoundaryCloud,
    instances: Sequence[Instance],
    estimates: Sequence[PoseEstimate | None],
    surface: SurfaceModel,
    config: LeftoverConfig | None = None,
) -> list[Instance]:
    """Return what the poses leave over of the groups that they were found in.

    Args:
        boundary: All boundary points of a frame.
        instances: Groups of these points.
        estimates: Pose of each group; None where none was found. Such a group was searched as a whole already, and
            so was one whose pose is too doubtful to take points away.
        surface: Samples of the part's surface.
        config: Limits; the defaults of :class:`LeftoverConfig` if None.

    Returns:
        A group of points for each group that is large enough, with its score; none if no pose takes points away.
    """
    config = config or LeftoverConfig()
    likely = [e for e in estimates if e is not None and e.score >= config.min_score]
    if not likely:
        return []
    likely.sort(key=lambda estimate: -estimate.score)
    claims = claimed_points(boundary, [e.T_cam_part for e in likely], surface, ExplanationConfig(min_points=1))
    found = []
    for instance, estimate in zip(instances, estimates, strict=True):
        if estimate is None or estimate.score < config.min_score:
            continue
        left = instance.point_idx[claims[instance.point_idx] < 0]
        if len(left) >= max(config.min_points, config.min_share * len(instance.point_idx)):
            found.append(Instance(point_idx=np.sort(left), score=instance.score, label=instance.label))
    return found

"""The whole of perception on one screen: a frame becomes boundary points, groups of them, and poses of parts."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

from perception.boundary import BoundaryCloud, extract_boundary
from perception.frame import Frame, Workspace
from perception.instance import Instance
from perception.part import PartModel
from perception.pose.estimator import PoseEstimator
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.explanation import explain_segments
from perception.segmentation.surface import coarse_surface

if TYPE_CHECKING:  # it brings torch, which only a network needs
    from perception.segmentation.predictor import SegmentationPredictor

STAGES = ("boundary", "segmentation", "poses", "explanation")


@dataclass(frozen=True, eq=False, kw_only=True)
class Perception:
    """What was seen in one frame.

    Attributes:
        boundary: Its N boundary points.
        segments: Groups of them before any pose is known, best first.
        poses: Verified poses of parts, best first; ``instance_idx`` counts in ``segments``.
        instances: The groups once the poses have taken what is theirs, best first.
        ms: Wall clock of each of `STAGES` [ms].
        estimates: Best pose of each segment, verified or not; None where there is none.
    """

    boundary: BoundaryCloud
    segments: list[Instance]
    poses: list[PoseEstimate]
    instances: list[Instance]
    ms: dict[str, float]
    estimates: list[PoseEstimate | None] = field(default_factory=list)


class Pipeline:
    """Frame -> boundary -> segments -> poses, for one kind of part in one bin."""

    def __init__(self, predictor: "SegmentationPredictor", estimator: PoseEstimator, workspace: Workspace) -> None:
        self.predictor = predictor
        self.estimator = estimator
        self.workspace = workspace

    @classmethod
    def for_part(cls, part: PartModel, workspace: Workspace) -> "Pipeline":
        """Use the weights for the part's name, and build its models: seconds the first time.

        Raises:
            WeightsError: There are no weights; the text names the commands that make them.
            ValueError: The part's mesh does not enclose a volume.
        """
        from perception.segmentation.predictor import SegmentationPredictor

        return cls(SegmentationPredictor.for_part(part.name), PoseEstimator(part, workspace=workspace), workspace)

    def perceive(self, frame: Frame) -> Perception:
        """Return what a frame shows; an empty bin, or a frame without depth, shows nothing."""
        d_max = self.estimator.part.d_max

        def segment(boundary: BoundaryCloud) -> list[Instance]:
            return self.predictor.predict(boundary, coarse_surface(frame, self.workspace, d_max), d_max)

        return perceive_by(segment, self.estimator, frame, self.workspace)


def perceive_by(
    segment: Callable[[BoundaryCloud], list[Instance]], estimator: PoseEstimator, frame: Frame, workspace: Workspace
) -> Perception:
    """Return what a frame shows if ``segment`` groups its boundary points: the way of all segmentations to poses."""
    clock = [time.perf_counter()]
    boundary = extract_boundary(frame, workspace)
    clock.append(time.perf_counter())
    segments = segment(boundary)
    clock.append(time.perf_counter())
    estimates = estimator.estimate_groups(boundary, segments, frame)
    poses = estimator.verified(estimates)
    clock.append(time.perf_counter())
    instances = explain_segments(boundary, segments, estimates, estimator.surface)
    clock.append(time.perf_counter())
    ms = {name: 1000 * (b - a) for name, (a, b) in zip(STAGES, pairwise(clock), strict=True)}
    return Perception(
        boundary=boundary, segments=segments, poses=poses, instances=instances, ms=ms, estimates=estimates
    )

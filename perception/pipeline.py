"""The perception pipeline: from a frame to boundary points, to segments, to poses of parts."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from perception.bin import BinFit, Trust, check_trust, find_bin, reconcile
from perception.boundary import BoundaryCloud, BoundarySettings, extract_boundary
from perception.diagnosis import (
    ABOUT_BIN,
    BinFacts,
    FrameReport,
    PoseCounts,
    bin_size_cause,
    diagnose,
    log_causes,
    swapped_centre_cause,
)
from perception.frame import Frame, Workspace
from perception.geometry import Floats, require_kind
from perception.instance import Instance
from perception.part import PartModel
from perception.pose.estimator import PoseEstimator
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.group_search import GroupSearch
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.explanation import explain_segments
from perception.runtime.garbage import collection_paused
from perception.runtime.threads import default_threads, use_threads
from perception.segmentation.surface import coarse_surface
from perception.thickness import part_boundary

if TYPE_CHECKING:  # importing it loads torch, which only a network needs
    from perception.segmentation.predictor import SegmentationPredictor

STAGES = ("bin", "boundary", "segmentation", "poses", "explanation")


@dataclass(frozen=True, eq=False, kw_only=True)
class Perception:
    """Result of the pipeline for one frame.

    Attributes:
        boundary: Boundary points of the frame.
        segments: Groups of boundary points as the segmentation found them, best first.
        groups: The segments, and after them the points that poses left over of some: parts that were merged.
        poses: Verified poses of parts, best first; ``instance_idx`` is an index into ``groups``.
        instances: Groups of boundary points after the poses have explained points, best first.
        ms: Wall clock of each of `STAGES` [ms]; without "bin" if the bin was taken as given.
        estimates: Best pose of each of the ``groups``, verified or not; None for a group without a pose.
        report: Facts of the frame and likely causes of lost parts; its time is no part of ``ms``.
        bin: The bin as the frame shows it; None if it was taken as given.
        workspace: The bin that poses were searched in.
        T_world_cam: (4, 4) camera pose that goes with it: that of the frame, or the corrected one.
    """

    boundary: BoundaryCloud
    segments: list[Instance]
    groups: list[Instance]
    poses: list[PoseEstimate]
    instances: list[Instance]
    ms: dict[str, float]
    estimates: list[PoseEstimate | None] = field(default_factory=list)
    report: FrameReport | None = None
    bin: BinFit | None = None
    workspace: Workspace | None = None
    T_world_cam: Floats | None = None


class Pipeline:
    """Frame, boundary points, segments, poses: the pipeline for one kind of part in one bin.

    Attributes:
        predictor: Segmentation of boundary points.
        estimator: Pose estimation of segments.
        workspace: Pose and size of the bin, as they are believed to be.
        measure_bin: Whether the bin's pose is measured in each frame.
        trust: What is corrected where the frame shows the bin elsewhere; see :func:`perception.bin.reconcile`.
        boundary: Settings of the boundary points.
    """

    def __init__(
        self,
        predictor: "SegmentationPredictor",
        estimator: PoseEstimator,
        workspace: Workspace,
        *,
        measure_bin: bool = True,
        trust: Trust = "camera",
        boundary: BoundarySettings | None = None,
    ) -> None:
        """Put the stages together.

        Args:
            predictor: Segmentation of boundary points.
            estimator: Pose estimation of segments; it holds its own settings.
            workspace: Pose and size of the bin, as they are believed to be.
            measure_bin: Whether to measure the bin's pose in each frame, starting from that of ``workspace``.
            trust: "camera" if the camera's pose is right and the bin may have moved; "bin" if the bin stands where it
                is said to be, and what is measured corrects the camera's pose.
            boundary: Settings of the boundary points; those that suit the part if None.

        Raises:
            ValueError: ``trust`` is neither of the two, or ``workspace`` is no workspace.
        """
        check_trust(trust)
        require_kind("workspace", workspace, Workspace, "it holds T_world_bin and inner_size")
        self.predictor = predictor
        self.estimator = estimator
        self.workspace = workspace
        self.measure_bin = measure_bin
        self.trust = trust
        self.boundary = boundary or part_boundary(estimator.part)

    @classmethod
    def for_part(
        cls,
        part: PartModel,
        workspace: Workspace,
        *,
        measure_bin: bool = True,
        trust: Trust = "camera",
        boundary: BoundarySettings | None = None,
        estimator: EstimatorConfig | None = None,
    ) -> "Pipeline":
        """Return the pipeline for a part, with the weights of its own or those for every part.

        Building the models of a part takes seconds the first time; later they come from the cache.

        Args:
            part: Part to search for.
            workspace: Pose and size of the bin, as they are believed to be.
            measure_bin: Whether to measure the bin's pose in each frame.
            trust: What is corrected where the frame shows the bin elsewhere; see :class:`Pipeline`.
            boundary: Settings of the boundary points; those that suit the part if None.
            estimator: Settings of the pose estimation; the defaults of :class:`EstimatorConfig` if None.

        Raises:
            WeightsError: There are neither weights of the part nor for every part.
            ValueError: The mesh of the part does not enclose a volume, or an argument is of another kind.
        """
        require_kind("part", part, PartModel, "load_part(...).model is one, and PartModel.from_mesh makes one")
        with use_threads(default_threads()), collection_paused():
            from perception.segmentation.predictor import SegmentationPredictor

            predictor, poses = SegmentationPredictor.for_part(part), PoseEstimator(part, estimator, workspace)
        return cls(predictor, poses, workspace, measure_bin=measure_bin, trust=trust, boundary=boundary)

    def perceive(self, frame: Frame) -> Perception:
        """Return the poses of the parts in a frame; none for an empty bin or a frame without depth.

        Where the measurement of the bin is not reliable, its given pose is kept, and the report says why.

        Raises:
            ValueError: ``frame`` is no frame.

        Note:
            It computes on one thread, or as many as :func:`perception.runtime.use_threads` around it says. The result
            does not depend on their number. Several threads may use one pipeline.
        """
        require_kind("frame", frame, Frame, "it holds depth, K, T_world_cam and perhaps grey")
        with use_threads(default_threads()):
            return self._perceive_frame(frame)

    def _perceive_frame(self, frame: Frame) -> Perception:
        """Measure the bin where that is asked for, and find the poses."""
        if not self.measure_bin:
            return self._perceive(frame, self.workspace)
        started = time.perf_counter()
        fit = find_bin(frame, self.workspace.inner_size, self.workspace)
        corrected, workspace = reconcile(frame, self.workspace, fit, self.trust)
        ms = {"bin": 1000 * (time.perf_counter() - started)}
        seen = self._perceive(corrected, workspace)
        report = seen.report
        if report is not None:
            cause = bin_size_cause(fit, self.workspace.inner_size, report.causes)
            causes = report.causes if cause is None else (cause, *report.causes)
            if fit.reliable and all(each.name != "camera_matrix" for each in causes):
                # The measured bin stands where a wrong camera matrix puts it, so that the believed one is asked.
                cause = swapped_centre_cause(frame, self.workspace)
                causes = causes if cause is None else (cause, *causes)
            report = replace(report, bin=BinFacts.of(fit, self.workspace), causes=causes)
            _log(report, self.estimator)
        return replace(seen, bin=fit, report=report, ms=ms | seen.ms)

    def _perceive(self, frame: Frame, workspace: Workspace) -> Perception:
        """Return the poses in a frame of a bin whose pose is known."""
        d_max = self.estimator.part.d_max

        def segment(boundary: BoundaryCloud) -> list[Instance]:
            surface = coarse_surface(frame, workspace, d_max) if self.predictor.needs_surface else None
            return self.predictor.predict(boundary, surface, d_max)

        return perceive_by(segment, self.estimator, frame, workspace, self.boundary)


def perceive_by(
    segment: Callable[[BoundaryCloud], list[Instance]],
    estimator: PoseEstimator,
    frame: Frame,
    workspace: Workspace,
    settings: BoundarySettings | None = None,
) -> Perception:
    """Run the pipeline on a frame with any segmentation.

    Args:
        segment: Returns the groups of a boundary cloud, best first.
        estimator: Pose estimation of segments.
        frame: Frame of the camera.
        workspace: Pose and size of the bin, which are taken as they are.
        settings: Settings of the boundary points; those that suit the part if None.

    Note:
        It computes on as many threads as :meth:`Pipeline.perceive` does.
    """
    with use_threads(default_threads()):
        return _perceive_by(segment, estimator, frame, workspace, settings)


def _perceive_by(
    segment: Callable[[BoundaryCloud], list[Instance]],
    estimator: PoseEstimator,
    frame: Frame,
    workspace: Workspace,
    settings: BoundarySettings | None,
) -> Perception:
    """Run the stages, and time them."""
    if estimator.workspace is not None:  # otherwise no bin is to limit the poses
        estimator = estimator.within(workspace)
    clock = [time.perf_counter()]
    boundary = extract_boundary(frame, workspace, settings or part_boundary(estimator.part))
    clock.append(time.perf_counter())
    segments = segment(boundary)
    clock.append(time.perf_counter())
    searches = estimator.search_groups(boundary, segments, frame)
    missed = _rejected_by_bin(estimator, searches, frame, workspace)
    estimates = estimator.select(searches)
    estimates += [None for _ in segments[len(estimates) :]]  # without boundary points nothing is searched
    leftovers, more = estimator.estimate_leftovers(boundary, segments, estimates, frame)
    estimates = [*estimates, *more]
    poses = estimator.verified(estimates)
    clock.append(time.perf_counter())
    instances = explain_segments(boundary, segments, estimates, estimator.surface)
    clock.append(time.perf_counter())
    counts = _count_poses(estimates, poses, missed, estimator.config.min_score)
    report = diagnose(frame, workspace, estimator.part, boundary, counts)
    _log(report, estimator)
    ms = {name: 1000 * (b - a) for name, (a, b) in zip(STAGES[1:], pairwise(clock), strict=True)}
    return Perception(
        boundary=boundary,
        segments=segments,
        groups=[*segments, *leftovers],
        poses=poses,
        instances=instances,
        ms=ms,
        estimates=estimates,
        report=report,
        workspace=workspace,
        T_world_cam=frame.T_world_cam,
    )


def _log(report: FrameReport, estimator: PoseEstimator) -> None:
    """Log the causes of a report; none about the bin where no bin limits the poses."""
    log_causes(report, without=ABOUT_BIN if estimator.workspace is None else ())


def _rejected_by_bin(
    estimator: PoseEstimator, searches: list[GroupSearch], frame: Frame, workspace: Workspace
) -> list[str | None]:
    """Return what the best hypothesis of each group reaches through, ``floor`` or ``walls``; None if it is possible."""
    rejected: list[str | None] = []
    for search in searches:
        through = None
        if search.missed is not None:
            floor, walls = estimator.body.protrusions(frame.T_world_cam @ search.missed.T_cam_part, workspace)
            through = "floor" if floor >= walls else "walls"
        rejected.append(through)
    return rejected


def _count_poses(
    estimates: list[PoseEstimate | None], poses: list[PoseEstimate], missed: list[str | None], min_score: float
) -> PoseCounts:
    """Count what became of each group.

    Args:
        estimates: Best pose of each group; None for a group without a pose.
        poses: Verified poses among them.
        missed: What the best hypothesis of each of the first groups reaches through; None if it is possible.
        min_score: Least score of a verified pose.
    """
    found = {pose.instance_idx for pose in poses}
    fates = Counter[str]()
    for k, estimate in enumerate(estimates):
        if k in found:
            fates["found"] += 1
        elif k < len(missed) and missed[k] is not None:
            fates[f"by_{missed[k]}"] += 1
        elif estimate is None:
            fates["without_pose"] += 1
        else:
            fates["by_score" if estimate.score < min_score else "by_neighbours"] += 1
    return PoseCounts(groups=len(estimates), **fates)

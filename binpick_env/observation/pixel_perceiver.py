"""Perceivers that work from pixels: segments by the trained network or the true ones, poses by PPF-MEAM."""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from binpick_env.candidates import PoseCandidate
from binpick_env.observation.candidate_from_pose import make_candidate
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.warm_up import warm_up_capture
from perception.boundary import BoundaryCloud
from perception.diagnosis import causes_unlogged
from perception.frame import Workspace
from perception.geometry import transform_points
from perception.instance import Instance, true_instances
from perception.part import PartModel
from perception.pipeline import Perception, Pipeline, perceive_by
from perception.pose.estimator import PoseEstimator
from perception.pose.pose_estimate import PoseEstimate
from perception.runtime.threads import use_threads
from perception.segmentation.choices import NetworkName
from perception.segmentation.grouping.similarity import GroupingConfig

LIKELY = 0.5  # smallest surface score of a likely pose: what a gripper meets is more likely there than not
MIN_POINTS = GroupingConfig().min_points  # smallest number of points of a true segment; the network's is the same
_log = logging.getLogger(__name__)
_warmed_up: set[str] = set()  # perception modes whose kernels this process has loaded


class PixelPerceiver:
    """Turns verified poses into candidates. Ground truth is read only to name their parts, for reports.

    Where no pose is verified, the likely ones become candidates, so that the last part of a bin can still be picked.
    They also do where they are asked for: when no grasp on a verified one can be tried.
    """

    def __init__(
        self,
        recognise: Callable[[LabelledCapture], Perception],
        estimator: PoseEstimator,
        threads: int | None = None,
    ) -> None:
        """Create the perceiver.

        Args:
            recognise: Function from a labelled capture to segments and poses.
            estimator: Estimator that made these poses; it also knows P, the boundary points of a whole part.
            threads: Number of threads that torch and OpenCV may use in the meantime; None changes nothing.
        """
        self._recognise = recognise
        self._estimator = estimator
        self._threads = threads

    def perceive(
        self,
        labelled: LabelledCapture,
        rng: np.random.Generator,  # noqa: ARG002 - for oracles
        *,
        likely: bool = False,
    ) -> ObservedCandidates:
        """Return a candidate for each verified pose, and for each likely one if asked for, best first."""
        with use_threads(self._threads):
            perceived = self._recognise(labelled)
        if likely or not perceived.poses:
            likely_ones = [each for each in perceived.estimates if each is not None and each.surface_score >= LIKELY]
            perceived = replace(perceived, poses=self._estimator.verified(likely_ones, min_score=0.0))
        owners = point_owners(labelled, perceived.boundary)
        groups = [perceived.groups[pose.instance_idx].point_idx for pose in perceived.poses]
        pairs = zip(perceived.poses, groups, strict=True)
        candidates = [self._candidate(labelled, pose, owners[idx]) for pose, idx in pairs]
        return ObservedCandidates(candidates=candidates, perception=perceived)

    def _candidate(self, labelled: LabelledCapture, pose: PoseEstimate, owners: NDArray[np.int64]) -> PoseCandidate:
        """Complete a pose to a candidate; (M,) ``owners`` are the true parts under its segment's points."""
        frame = labelled.capture.frame
        depth = float(transform_points(pose.T_cam_part, labelled.part.centre[None])[0, 2])
        whole = self._estimator.appearances.expected_points(frame.K, depth)
        return make_candidate(
            labelled,
            frame.T_world_cam @ pose.T_cam_part,
            score=pose.score,
            visible_fraction=pose.visible_fraction,
            fill=len(owners) / max(whole, 1),
            part=main_owner(owners),
        )


def learned_perceiver(
    part: PartModel, workspace: Workspace, threads: int | None = None, network: NetworkName = "grid"
) -> PixelPerceiver:
    """Build the perceiver that segments with a trained network of a kind.

    Raises:
        WeightsError: There are no weights for the part; the text names the commands that make them and the other modes.
        ValueError: The part's mesh does not enclose a volume.
    """
    # Imported here: torch takes seconds to load, and true segments need none.
    from perception.segmentation.predictor import SegmentationPredictor
    from perception.segmentation.weights import WeightsError

    try:
        # The cell's bin stands where its model says, so that measuring it would cost time and gain nothing.
        predictor = SegmentationPredictor.for_part(part, network=network)
        pipeline = Pipeline(predictor, PoseEstimator(part, workspace=workspace), workspace, measure_bin=False)
    except WeightsError as error:
        raise WeightsError(
            f"perception='learned' cannot recognise {part.name!r}: {error}; without a network there are "
            "perception='gt_masks' (true segments) and 'oracle' (true poses)"
        ) from error
    perceiver = PixelPerceiver(lambda labelled: pipeline.perceive(labelled.capture.frame), pipeline.estimator, threads)
    return _warm_up(perceiver, "learned", part, workspace)


def gt_masks_perceiver(part: PartModel, workspace: Workspace, threads: int | None = None) -> PixelPerceiver:
    """Build the perceiver that takes the true segments.

    Raises:
        ValueError: The part's mesh does not enclose a volume.
    """
    estimator = PoseEstimator(part, workspace=workspace)

    def recognise(labelled: LabelledCapture) -> Perception:
        def segment(boundary: BoundaryCloud) -> list[Instance]:
            return true_instances(point_owners(labelled, boundary), MIN_POINTS)

        return perceive_by(segment, estimator, labelled.capture.frame, workspace)

    return _warm_up(PixelPerceiver(recognise, estimator, threads), "gt_masks", part, workspace)


def _warm_up(perceiver: PixelPerceiver, mode: str, part: PartModel, workspace: Workspace) -> PixelPerceiver:
    """Let the first perceiver of each mode in this process perceive a small capture, so that its kernels are loaded.

    Kernels are compiled (25 s) or read from numba's cache (1 s) at their first call, which would count as time of the
    first frame.
    """
    if mode not in _warmed_up:
        _log.info("loading the kernels of perception; if they are not compiled yet, this takes about 40 s")
        with causes_unlogged():  # its camera is not the user's, who could not mend them
            perceiver.perceive(warm_up_capture(part, workspace), np.random.default_rng(0))
        _warmed_up.add(mode)
    return perceiver


def point_owners(labelled: LabelledCapture, boundary: BoundaryCloud) -> NDArray[np.int64]:
    """Return the (N,) true parts that the boundary points lie on, -1 for none."""
    owners: NDArray[np.int64] = labelled.capture.measured_ids[boundary.pixels[:, 1], boundary.pixels[:, 0]]
    return owners


def main_owner(owners: NDArray[np.int64]) -> int:
    """Return the most frequent part among (M,) ``owners`` of a segment's points; -1 where most lie on no part."""
    return int(np.bincount(owners + 1).argmax()) - 1

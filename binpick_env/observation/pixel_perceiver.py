"""Perceivers that work from pixels: segments by the trained network, or the true ones; poses by PPF-MEAM.

Torch is imported only for the network.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from binpick_env.candidates import PoseCandidate
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.perceiver import LabelledCapture, make_candidate
from binpick_env.observation.warm_up import warm_up_capture
from perception.boundary import BoundaryCloud
from perception.frame import Workspace
from perception.geometry import transform_points
from perception.instance import Instance, true_instances
from perception.part import PartModel
from perception.pipeline import Perception, Pipeline, perceive_by
from perception.pose.estimator import PoseEstimator
from perception.pose.pose_estimate import PoseEstimate
from perception.runtime.threads import use_threads
from perception.segmentation.grouping.similarity import GroupingConfig

LIKELY = 0.5  # score of a pose that is offered where none is verified: it is rather right than wrong
MIN_POINTS = GroupingConfig().min_points  # of a true segment: the network's smallest group
_warmed_up: set[str] = set()  # the ways to segments for which this process has its kernels


class PixelPerceiver:
    """Verified poses become candidates; the truth beside the frame names their parts, for reports only.

    Where no pose is verified, those that are likely stand in: the last part of a bin is not given up for a doubt.
    """

    def __init__(
        self, see: Callable[[LabelledCapture], Perception], estimator: PoseEstimator, threads: int | None = None
    ) -> None:
        """Look with ``see``.

        Args:
            see: From an exposure to segments and poses.
            estimator: Of these poses; it knows P.
            threads: That torch and OpenCV may use in the meantime; None leaves them alone.
        """
        self._see = see
        self._estimator = estimator
        self._threads = threads

    def perceive(self, view: LabelledCapture, rng: np.random.Generator) -> ObservedCandidates:  # noqa: ARG002 - chance is the oracle's
        """Return a candidate for each verified pose, best first; an empty bin has none."""
        with use_threads(self._threads):
            seen = self._see(view)
        if not seen.poses:
            seen = replace(seen, poses=self._estimator.verified(seen.estimates, LIKELY))
        owners = point_owners(view, seen.boundary)
        groups = [seen.segments[pose.instance_idx].point_idx for pose in seen.poses]
        candidates = [self._candidate(view, pose, owners[idx]) for pose, idx in zip(seen.poses, groups, strict=True)]
        return ObservedCandidates(candidates=candidates, perception=seen)

    def _candidate(self, view: LabelledCapture, pose: PoseEstimate, owners: NDArray[np.int64]) -> PoseCandidate:
        """Complete a pose whose group's points lie on the parts (M,) ``owners``."""
        frame = view.capture.frame
        depth = float(transform_points(pose.T_cam_part, view.part.centre[None])[0, 2])
        whole = self._estimator.appearances.expected_points(frame.K, depth)
        return make_candidate(
            view,
            frame.T_world_cam @ pose.T_cam_part,
            score=pose.score,
            visible_fraction=pose.visible_fraction,
            fill=len(owners) / max(whole, 1),
            part=main_owner(owners),
        )


def learned_perceiver(part: PartModel, workspace: Workspace, threads: int | None = None) -> PixelPerceiver:
    """Build the perceiver whose segments are the trained network's.

    Raises:
        WeightsError: There are no weights for the part; the text names the commands that make them and the other modes.
        ValueError: The part's mesh does not enclose a volume.
    """
    from perception.segmentation.weights import WeightsError

    try:
        pipeline = Pipeline.for_part(part, workspace)
    except WeightsError as error:
        raise WeightsError(
            f"perception='learned' cannot look for {part.name!r}: {error}; without a network there are "
            "perception='gt_masks' (true segments) and 'oracle' (true poses)"
        ) from error
    perceiver = PixelPerceiver(lambda view: pipeline.perceive(view.capture.frame), pipeline.estimator, threads)
    return _warm_up(perceiver, "learned", part, workspace)


def gt_masks_perceiver(part: PartModel, workspace: Workspace, threads: int | None = None) -> PixelPerceiver:
    """Build the perceiver whose segments are the true ones.

    Raises:
        ValueError: The part's mesh does not enclose a volume.
    """
    estimator = PoseEstimator(part, workspace=workspace)

    def see(view: LabelledCapture) -> Perception:
        def segment(boundary: BoundaryCloud) -> list[Instance]:
            return true_instances(point_owners(view, boundary), MIN_POINTS)

        return perceive_by(segment, estimator, view.capture.frame, workspace)

    return _warm_up(PixelPerceiver(see, estimator, threads), "gt_masks", part, workspace)


def _warm_up(perceiver: PixelPerceiver, way: str, part: PartModel, workspace: Workspace) -> PixelPerceiver:
    """Let the first perceiver of its way look once at a view that nobody waits for.

    Kernels are compiled, or read from numba's cache, at their first call: 25 s, or 1 s, that are no part of a frame's
    time.
    """
    if way not in _warmed_up:
        perceiver.perceive(warm_up_capture(part, workspace), np.random.default_rng(0))
        _warmed_up.add(way)
    return perceiver


def point_owners(view: LabelledCapture, boundary: BoundaryCloud) -> NDArray[np.int64]:
    """Return the (N,) true part that each boundary point lies on, -1 for none."""
    owners: NDArray[np.int64] = view.capture.instance_ids[boundary.pixels[:, 1], boundary.pixels[:, 0]]
    return owners


def main_owner(owners: NDArray[np.int64]) -> int:
    """Return the part that owns most of a group's (M,) points, -1 where most of them lie on none."""
    return int(np.bincount(owners + 1).argmax()) - 1

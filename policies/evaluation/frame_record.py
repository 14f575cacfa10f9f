"""What perception found in a frame, compared with the ground truth: plain numbers for a bin's record.

G segments, P parts, N boundary points, E candidates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from binpick_env.candidates import MAX_CANDIDATES, PoseCandidate
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.pixel_perceiver import point_owners
from perception.geometry import Floats
from perception.instance import Instance, instances_of, labels_of
from perception.metrics.matching import SceneMatches, match_scene
from perception.metrics.pose_errors import is_recognised, pose_error, recognition_distances
from perception.metrics.pose_recognition import MIN_VISIBLE, judge_poses
from perception.segmentation.scoring import truth_of

GOOD_OVERLAP = 0.5  # smallest IoU of a good segment with its part
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class SegmentTable:
    """Numbers of boundary points that a frame's segments share with its parts: the input of an average precision.

    Attributes:
        scores: Confidence of each of the G segments.
        points: (segment, part, number of points) of every pair that shares points; -1 is no segment, and no part.
    """

    scores: tuple[float, ...]
    points: tuple[tuple[int, int, int], ...]

    def __post_init__(self) -> None:
        for group, part, count in self.points:
            if not (-1 <= group < len(self.scores) and part >= -1 and count > 0):
                raise ValueError(
                    "points must be (segment, part, number of points) with a segment from -1 to "
                    f"{len(self.scores) - 1}, got {(group, part, count)}"
                )

    @classmethod
    def count(cls, instances: Sequence[Instance], part_ids: Ints) -> "SegmentTable":
        """Count the points of each segment on each part; a point of several segments belongs to the first.

        Args:
            instances: Segments, best first.
            part_ids: (N,) true part of each boundary point, -1 for the container.
        """
        pairs = np.column_stack([labels_of(instances, len(part_ids)), part_ids])
        shared, counts = np.unique(pairs, axis=0, return_counts=True)
        points = tuple((int(g), int(p), int(n)) for (g, p), n in zip(shared, counts, strict=True))
        return cls(scores=tuple(float(instance.score) for instance in instances), points=points)

    def matches(self, visible_fractions: Sequence[float]) -> SceneMatches:
        """Return the segments matched with the parts by ScanNet's rules, as in every other evaluation.

        Args:
            visible_fractions: Visible fraction of each of the P parts.
        """
        groups, parts, counts = np.array(self.points, np.int64).reshape(-1, 3).T
        truth = truth_of(np.repeat(parts, counts), np.asarray(visible_fractions, np.float64))
        return match_scene(truth, instances_of(np.repeat(groups, counts), self.scores))


@dataclass(frozen=True, kw_only=True)
class CandidateRecord:
    """One candidate of a frame, compared with the ground truth.

    A pose is correct by the paper's criterion: off by at most a tenth of d_max at the part's centre and at most 5 deg
    modulo symmetry.

    Attributes:
        part: Index of the part that owns most points of the candidate's group, which is a segment or what a pose left
            over of one; -1 where most are on no part.
        score: Confidence of the perceiver.
        right: Whether the pose is correct for ``part``.
        found: Index of the part for which this is the best-scored correct pose; -1 for none, and for a duplicate.
        translation: Distance of the part's centre from its true place [m]; None without a part.
        rotation: Angle to the true rotation, modulo symmetry [rad]; None without a part.
        overlap: IoU of the candidate's group with the part's boundary points; None where nothing was segmented.
    """

    part: int
    score: float
    right: bool
    found: int
    translation: float | None = None
    rotation: float | None = None
    overlap: float | None = None

    @property
    def well_segmented(self) -> bool:
        """Whether the candidate's group is good; True where nothing was segmented."""
        return self.overlap is None or (self.part >= 0 and self.overlap >= GOOD_OVERLAP)


@dataclass(frozen=True, kw_only=True)
class FrameRecord:
    """One frame that a decision was made on, compared with the ground truth.

    Attributes:
        frame_id: Number of the frame in its bin.
        visible_fractions: Visible fraction of each of the P parts; 0 for parts out of play.
        candidates: Candidates of the observation, in its order.
        segments: Segments that poses were searched in; None where the ground truth was read.
        explained: Segments after points were assigned to poses; None where the ground truth was read.
        ms: Wall clock of each stage of perception [ms].
        causes: Names of the likely causes of lost parts in the frame's report.
    """

    frame_id: int
    visible_fractions: tuple[float, ...]
    candidates: tuple[CandidateRecord, ...]
    segments: SegmentTable | None = None
    explained: SegmentTable | None = None
    ms: dict[str, float] = field(default_factory=dict)
    causes: tuple[str, ...] = ()

    @property
    def to_find(self) -> frozenset[int]:
        """Indices of the parts of which half or more is visible."""
        return frozenset(k for k, fraction in enumerate(self.visible_fractions) if fraction >= MIN_VISIBLE)

    @property
    def found(self) -> frozenset[int]:
        """Indices of those parts of `to_find` for which there is a candidate with a correct pose."""
        return self.to_find & {candidate.found for candidate in self.candidates}

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "FrameRecord":
        """Return the record whose fields are given as JSON types."""
        return cls(
            frame_id=values["frame_id"],
            visible_fractions=tuple(values["visible_fractions"]),
            candidates=tuple(CandidateRecord(**candidate) for candidate in values["candidates"]),
            segments=_table(values["segments"]),
            explained=_table(values["explained"]),
            ms=values["ms"],
            causes=tuple(values.get("causes", ())),  # which records of older versions lack
        )


def record_frame(frame_id: int, labelled_capture: LabelledCapture, observed: ObservedCandidates) -> FrameRecord:
    """Compare what perception found in a frame with the ground truth.

    Args:
        frame_id: Number of the frame in its bin.
        labelled_capture: The frame with its ground truth.
        observed: What perception found; the first `MAX_CANDIDATES` candidates, those of the observation, are recorded.
    """
    perception = observed.perception
    report = None if perception is None else perception.report
    candidates = observed.candidates[:MAX_CANDIDATES]
    segments = explained = None
    overlaps: list[float | None] = [None] * len(candidates)
    if perception is not None:
        part_ids = point_owners(labelled_capture, perception.boundary)
        segments, explained = (
            SegmentTable.count(found, part_ids) for found in (perception.segments, perception.instances)
        )
        groups = [perception.groups[pose.instance_idx] for pose in perception.poses[: len(candidates)]]
        overlaps = [_overlap(group, each.part, part_ids) for group, each in zip(groups, candidates, strict=True)]
    facts = zip(candidates, _found(labelled_capture, candidates), overlaps, strict=True)
    return FrameRecord(
        frame_id=frame_id,
        visible_fractions=tuple(labelled_capture.visible_fractions.tolist()),
        candidates=tuple(_candidate(labelled_capture, *each) for each in facts),
        segments=segments,
        explained=explained,
        ms={} if perception is None else dict(perception.ms),
        causes=() if report is None else tuple(cause.name for cause in report.causes),
    )


def _candidate(
    labelled_capture: LabelledCapture, candidate: PoseCandidate, found: int, overlap: float | None
) -> CandidateRecord:
    part, score = candidate.part, float(candidate.score)
    if part < 0:
        return CandidateRecord(part=-1, score=score, right=False, found=found, overlap=overlap)
    error = pose_error(candidate.T_world_part, labelled_capture.T_reported_parts[part], labelled_capture.part)
    return CandidateRecord(
        part=part,
        score=score,
        right=is_recognised(error, labelled_capture.part.d_max),
        found=found,
        translation=error.translation,
        rotation=error.rotation,
        overlap=overlap,
    )


def _overlap(group: Instance, part: int, part_ids: Ints) -> float:
    """Return the IoU of a group of points with the points of a part, given the (N,) true parts of all points."""
    own = part_ids == part
    shared = int(np.count_nonzero(own[group.point_idx]))
    union = len(group.point_idx) + int(np.count_nonzero(own)) - shared
    return shared / union if shared else 0.0


def _found(labelled_capture: LabelledCapture, candidates: Sequence[PoseCandidate]) -> list[int]:
    """Return for each of E candidates the visible part for which it is the best-scored correct pose, -1 for none."""
    T_world: Floats = np.array([candidate.T_world_part for candidate in candidates]).reshape(-1, 4, 4)
    distances = recognition_distances(T_world, labelled_capture.T_reported_parts, labelled_capture.part)
    distances[:, labelled_capture.visible_fractions <= 0] = np.inf
    scores = np.array([candidate.score for candidate in candidates], np.float64)
    judgement = judge_poses(distances, scores, np.ones(distances.shape[1], np.bool_), np.inf)
    return [int(part) if right else -1 for part, right in zip(judgement.claims, judgement.correct, strict=True)]


def _table(values: dict[str, Any] | None) -> SegmentTable | None:
    if values is None:
        return None
    return SegmentTable(scores=tuple(values["scores"]), points=tuple((g, p, n) for g, p, n in values["points"]))

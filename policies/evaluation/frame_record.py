"""What perception made of a frame, judged against the truth: plain numbers that a bin's record keeps.

G groups of boundary points, P parts, N boundary points, E candidates.
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

GOOD_OVERLAP = 0.5  # IoU with its part from which a group is a good segment
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class SegmentTable:
    """How a frame's groups of boundary points lie on its parts: all that an average precision asks of them.

    Attributes:
        scores: Confidence of each of the G groups.
        points: (group, part, number of points) of every pair that shares points; -1 is no group, and no part.
    """

    scores: tuple[float, ...]
    points: tuple[tuple[int, int, int], ...]

    def __post_init__(self) -> None:
        for group, part, count in self.points:
            if not (-1 <= group < len(self.scores) and part >= -1 and count > 0):
                raise ValueError(f"points must be of {len(self.scores)} groups, got {(group, part, count)}")

    @classmethod
    def count(cls, instances: Sequence[Instance], part_ids: Ints) -> "SegmentTable":
        """Count the points of ``instances`` on each part; of overlapping ones the first has a point.

        Args:
            instances: Groups of boundary points, best first.
            part_ids: (N,) true part of each boundary point, -1 for the container.
        """
        pairs = np.column_stack([labels_of(instances, len(part_ids)), part_ids])
        shared, counts = np.unique(pairs, axis=0, return_counts=True)
        points = tuple((int(g), int(p), int(n)) for (g, p), n in zip(shared, counts, strict=True))
        return cls(scores=tuple(float(instance.score) for instance in instances), points=points)

    def matches(self, visible_fractions: Sequence[float]) -> SceneMatches:
        """Return ScanNet's verdicts on the groups, by the rules of every other evaluation.

        Args:
            visible_fractions: Of the P parts.
        """
        groups, parts, counts = np.array(self.points, np.int64).reshape(-1, 3).T
        truth = truth_of(np.repeat(parts, counts), np.asarray(visible_fractions, np.float64))
        return match_scene(truth, instances_of(np.repeat(groups, counts), self.scores))

    def overlap(self, group: int, part: int) -> float:
        """Return the IoU of a group with a part's boundary points; 0 where there are none."""
        shared = sum(n for g, p, n in self.points if (g, p) == (group, part))
        union = sum(n for g, p, n in self.points if g == group or p == part)
        return shared / union if shared else 0.0


@dataclass(frozen=True, kw_only=True)
class CandidateRecord:
    """One offered pose, judged by the paper's criterion: a tenth of d_max at the centre, 5 deg modulo symmetry.

    Attributes:
        part: That the candidate is of: the one that owns most of its group's points; -1 where most are no part's.
        score: The perceiver's confidence.
        right: Whether the pose is right for ``part``.
        found: Part that this is the best-scored right pose of; -1 for none, and for a duplicate.
        translation: Error against ``part`` [m]; None without one.
        rotation: Error against ``part``, modulo its symmetry [rad]; None without one.
        overlap: IoU of its group with ``part``'s boundary points; None where nothing was segmented.
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
        """Whether the group behind it is a good segment; always where nothing was segmented."""
        return self.overlap is None or (self.part >= 0 and self.overlap >= GOOD_OVERLAP)


@dataclass(frozen=True, kw_only=True)
class FrameRecord:
    """One frame that was decided on.

    Attributes:
        frame_id: Of the frame in its bin.
        visible_fractions: Of the P parts, 0 out of play.
        candidates: What was offered, in the order of the observation.
        segments: The groups that poses were searched in; None where the truth was read.
        explained: The same after the poses have explained the points.
        ms: Wall clock of perception's stages [ms].
    """

    frame_id: int
    visible_fractions: tuple[float, ...]
    candidates: tuple[CandidateRecord, ...]
    segments: SegmentTable | None = None
    explained: SegmentTable | None = None
    ms: dict[str, float] = field(default_factory=dict)

    @property
    def to_find(self) -> frozenset[int]:
        """The parts of which half or more is visible."""
        return frozenset(k for k, fraction in enumerate(self.visible_fractions) if fraction >= MIN_VISIBLE)

    @property
    def found(self) -> frozenset[int]:
        """Those of `to_find` that a right pose was offered for."""
        return self.to_find & {candidate.found for candidate in self.candidates}

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "FrameRecord":
        """Rebuild a record from JSON's values."""
        return cls(
            frame_id=values["frame_id"],
            visible_fractions=tuple(values["visible_fractions"]),
            candidates=tuple(CandidateRecord(**candidate) for candidate in values["candidates"]),
            segments=_table(values["segments"]),
            explained=_table(values["explained"]),
            ms=values["ms"],
        )


def judge_frame(frame_id: int, labelled_capture: LabelledCapture, observed: ObservedCandidates) -> FrameRecord:
    """Compare what was seen in an exposure with its truth.

    Args:
        frame_id: Of the frame in its bin.
        labelled_capture: With the truth.
        observed: What perception made of it; the first `MAX_CANDIDATES` candidates are offered, and judged.
    """
    seen = observed.perception
    offered = observed.candidates[:MAX_CANDIDATES]
    segments = explained = None
    overlaps: list[float | None] = [None] * len(offered)
    if seen is not None:
        part_ids = point_owners(labelled_capture, seen.boundary)
        segments, explained = (SegmentTable.count(groups, part_ids) for groups in (seen.segments, seen.instances))
        groups = [pose.instance_idx for pose in seen.poses[: len(offered)]]
        overlaps = [segments.overlap(group, each.part) for group, each in zip(groups, offered, strict=True)]
    judged = zip(offered, _found(labelled_capture, offered), overlaps, strict=True)
    return FrameRecord(
        frame_id=frame_id,
        visible_fractions=tuple(labelled_capture.visible_fractions.tolist()),
        candidates=tuple(_judge(labelled_capture, candidate, found, overlap) for candidate, found, overlap in judged),
        segments=segments,
        explained=explained,
        ms={} if seen is None else dict(seen.ms),
    )


def _judge(
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


def _found(labelled_capture: LabelledCapture, candidates: Sequence[PoseCandidate]) -> list[int]:
    """Return for each of E candidates the part in sight that it is the best-scored right pose of, -1 for none."""
    T_world: Floats = np.array([candidate.T_world_part for candidate in candidates]).reshape(-1, 4, 4)
    distances = recognition_distances(T_world, labelled_capture.T_reported_parts, labelled_capture.part)
    distances[:, labelled_capture.visible_fractions <= 0] = np.inf
    scores = np.array([candidate.score for candidate in candidates], np.float64)
    verdicts = judge_poses(distances, scores, np.ones(distances.shape[1], np.bool_), np.inf)
    return [int(part) if right else -1 for part, right in zip(verdicts.claims, verdicts.correct, strict=True)]


def _table(values: dict[str, Any] | None) -> SegmentTable | None:
    if values is None:
        return None
    return SegmentTable(scores=tuple(values["scores"]), points=tuple((g, p, n) for g, p, n in values["points"]))

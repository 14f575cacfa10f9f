"""Scores of one scene: which trials are recognised, which poses are correct, which parts are found.

A pose is correct for a part by the paper's criterion: an error of at most 0.1 ``d_max`` at the part's centre and 5 deg
modulo symmetry. Shapes: P parts, T trials, E estimated poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.segmentation.record import record_path
from binpick_env.scenes.clutter import ClutterStats
from perception.geometry import Floats
from perception.metrics.matching import SceneMatches, match_scene
from perception.metrics.pose_distance import PoseSpace
from perception.metrics.pose_errors import is_recognised, pose_error, recognition_distances
from perception.metrics.pose_recognition import MAX_DISTANCE, PoseVerdicts, judge_poses, visible_enough
from perception.part import PartModel
from perception.segmentation.scoring import truth_of

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class TrialScores:
    """The recognition trials of a scene.

    Attributes:
        recognised: (T,) bool, whether the group's pose is correct for the part that most of its points lie on.
        translations: (T,) position error of the pose [m]; NaN without a pose.
        rotations: (T,) rotation error of the pose [rad]; NaN without a pose.
        purities: (T,) share of the group's points on that part.
    """

    recognised: Bools
    translations: Floats
    rotations: Floats
    purities: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseMatches:
    """K of a scene's poses matched to its parts; of several poses of a part only the best-scored is correct.

    Attributes:
        pose_idx: (K,) int64 index of each pose among the scene's E estimated poses.
        correct: (K,) bool, whether a pose is correct and no duplicate.
        matched_part: (K,) int64 part that a pose is close to, duplicates included; -1 for none.
        found: (P,) bool, whether a part has a correct pose.
        bregier: The same poses matched by Bregier's distance and rules.
    """

    pose_idx: NDArray[np.int64]
    correct: Bools
    matched_part: NDArray[np.int64]
    found: Bools
    bregier: PoseVerdicts


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseSceneScore:
    """Scores of a scene's estimated poses and groups.

    Attributes:
        index: Index of the scene.
        trials: Trials that a recognition rate counts.
        verified: Verified poses, matched to the parts.
        all_poses: All estimated poses, verified or not, matched to the parts.
        scores: (E,) score of each estimated pose, in [0, 1].
        correct: (E,) bool, whether a pose is correct for some part; duplicates count as correct.
        to_find: (P,) bool, whether the visible fraction of a part is at least 0.5.
        visible_fractions: (P,) true visible fraction of each part.
        segmentation: Groups matched to the parts; without any group where the whole scene was searched.
        explained: Groups after explanation by the poses, matched to the parts.
        clutter: Statistics of the visible fractions.
        groups: Number of groups in which poses were searched.
        ms: Wall clock of each stage [ms].
        threads: Number of threads that computed the scene.
        git_commit: Commit of the code that made the record.
        causes: Names of the likely causes of lost parts in the frame's report.
    """

    index: int
    trials: TrialScores
    verified: PoseMatches
    all_poses: PoseMatches
    scores: Floats
    correct: Bools
    to_find: Bools
    visible_fractions: Floats
    segmentation: SceneMatches
    explained: SceneMatches
    clutter: ClutterStats
    groups: int
    ms: dict[str, float]
    threads: int
    git_commit: str
    causes: tuple[str, ...] = ()

    @classmethod
    def from_record(
        cls, record: PoseRecord, index: int, part: PartModel, space: PoseSpace | None = None
    ) -> "PoseSceneScore":
        """Score a record.

        Args:
            record: Record of the scene.
            index: Index of the scene.
            part: Part that lies in the bin.
            space: `PoseSpace` of the part; computed unless given.
        """
        space = space or PoseSpace.of(part)
        distances = recognition_distances(record.poses, record.T_cam_parts, part)
        displacements = np.full(distances.shape, np.inf)
        if distances.size:  # `PoseSpace` needs at least one pose and one part
            displacements = space.distances(record.poses, record.T_cam_parts)
        to_find = visible_enough(record.visible_fractions)

        def match(pose_idx: NDArray[np.int64]) -> PoseMatches:
            limit = MAX_DISTANCE * part.d_max
            bregier = judge_poses(displacements[pose_idx], record.scores[pose_idx], to_find, limit)
            return _match_poses(pose_idx, distances[pose_idx], record.scores[pose_idx], bregier)

        return cls(
            index=index,
            trials=_trials(record, part),
            verified=match(np.flatnonzero(record.verified)),
            all_poses=match(np.arange(len(record.scores))),
            scores=record.scores,
            correct=np.asarray(np.isfinite(distances).any(axis=1)),
            to_find=to_find,
            visible_fractions=record.visible_fractions,
            segmentation=_segmentation(record),
            explained=record.segmentation(explained=True).matches(),
            clutter=ClutterStats.from_fractions(record.visible_fractions),
            groups=0 if record.whole_scene else len(record.confidences),
            ms=record.ms,
            threads=record.threads,
            git_commit=record.git_commit,
            causes=record.causes,
        )

    @property
    def recall(self) -> float:
        """Share of the parts to find that have a correct verified pose; NaN without a part to find."""
        return float(self.verified.found[self.to_find].mean()) if self.to_find.any() else np.nan


def load_pose_scores(folder: Path, count: int, part: PartModel) -> list[PoseSceneScore]:
    """Load and score the records of scenes 0 to ``count - 1``.

    Args:
        folder: Folder of the records.
        count: Number of scenes.
        part: Part that lies in the bins.

    Raises:
        RecordError: A record is missing or damaged.
    """
    space = PoseSpace.of(part)
    return [PoseSceneScore.from_record(PoseRecord.load(record_path(folder, k)), k, part, space) for k in range(count)]


def _match_poses(pose_idx: NDArray[np.int64], distances: Floats, scores: Floats, bregier: PoseVerdicts) -> PoseMatches:
    """Match K poses to P parts by their (K, P) distances, infinite where a pose is not correct for a part."""
    parts = distances.shape[1]
    verdicts = judge_poses(distances, scores, np.ones(parts, np.bool_), np.inf)
    found = np.zeros(parts, np.bool_)
    found[verdicts.claims[verdicts.correct]] = True
    return PoseMatches(
        pose_idx=pose_idx, correct=verdicts.correct, matched_part=verdicts.claims, found=found, bregier=bregier
    )


def _segmentation(record: PoseRecord) -> SceneMatches:
    if record.whole_scene:  # the groups are the true segments, which only define the trials
        return match_scene(truth_of(record.instance_ids, record.visible_fractions), [])
    return record.segmentation().matches()


def _trials(record: PoseRecord, part: PartModel) -> TrialScores:
    """Score each trial by the pose of its group, or by the scene's nearest pose where the whole scene was searched."""
    owners, purities = record.owners()
    rows = []
    for group in record.trials:
        poses = record.poses if record.whole_scene else record.poses[record.groups == group]
        T_true = None if owners[group] < 0 else record.T_cam_parts[owners[group]]
        rows.append(_trial(poses, T_true, part))
    columns = np.array(rows, np.float64).reshape(-1, 3)
    return TrialScores(
        recognised=columns[:, 0] > 0,
        translations=columns[:, 1],
        rotations=columns[:, 2],
        purities=purities[record.trials],
    )


def _trial(poses: Floats, T_true: Floats | None, part: PartModel) -> tuple[bool, float, float]:
    """Return whether a pose is correct, and the errors [m] and [rad] of the best one, a correct one if there is any."""
    if T_true is None or len(poses) == 0:
        return False, np.nan, np.nan
    errors = [pose_error(T, T_true, part) for T in poses]
    rated = [(not is_recognised(error, part.d_max), error.translation, error.rotation) for error in errors]
    missed, translation, rotation = min(rated)
    return not missed, translation, rotation


def worst_first(scores: Sequence[PoseSceneScore]) -> list[PoseSceneScore]:
    """Sort scenes by ascending recall, then by descending number of wrong poses; recall NaN comes last."""

    def order(score: PoseSceneScore) -> tuple[bool, float, int, int]:
        return bool(np.isnan(score.recall)), score.recall, -int((~score.verified.correct).sum()), score.index

    return sorted(scores, key=order)

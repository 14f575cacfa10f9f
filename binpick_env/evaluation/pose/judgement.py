"""One record of estimated poses judged: which trials, which delivered poses and which parts came out right.

A pose is right for a part by the paper's criterion: a tenth of ``d_max`` at the part's centre and 5 degrees modulo
symmetry. P parts, T trials, E estimated poses.
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
from perception.metrics.pose_error import is_recognised, pose_error, recognition_distances
from perception.metrics.pose_recognition import MAX_DISTANCE, PoseVerdicts, judge_poses, visible_enough
from perception.part import PartModel
from perception.segmentation.scoring import truth_of

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class TrialScores:
    """The recognition trials of a scene.

    Attributes:
        recognised: (T,) bool whether the pose is right for the part that owns most of the group's points.
        translations: (T,) its error [m]; NaN without a pose.
        rotations: (T,) its error [rad]; NaN without a pose.
        purities: (T,) share of the group's points on that part.
    """

    recognised: Bools
    translations: Floats
    rotations: Floats
    purities: Floats


@dataclass(frozen=True, eq=False, kw_only=True)
class Delivery:
    """Some of a scene's poses against its parts; only one pose a part is right, the best-scored.

    Attributes:
        which: (K,) int64 index of each pose among the estimated ones.
        right: (K,) bool.
        claims: (K,) int64 part that a pose is of, duplicates' too, -1 for none.
        found: (P,) bool parts that a right pose is of.
        bregier: The same poses by Bregier's distance and rules.
    """

    which: NDArray[np.int64]
    right: Bools
    claims: NDArray[np.int64]
    found: Bools
    bregier: PoseVerdicts


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseScore:
    """What is needed of a record beside its points.

    Attributes:
        index: Of the scene.
        trials: That a recognition rate counts.
        delivered: The verified poses.
        every: All poses, as if nothing were verified.
        scores: (E,) of all poses.
        fits: (E,) bool whether a pose is right for some part, whether or not another one is so too.
        to_find: (P,) bool parts of which half or more is visible.
        visible_fractions: (P,).
        segmentation: Verdicts on the groups; on none where the whole scene was searched.
        explained: Verdicts on the groups after the poses have explained them.
        clutter: How hidden the parts are.
        groups: Number of groups that poses were searched in.
        ms: Wall clock by stage [ms].
        threads: That computed.
        git_commit: Of the code that made the record.
    """

    index: int
    trials: TrialScores
    delivered: Delivery
    every: Delivery
    scores: Floats
    fits: Bools
    to_find: Bools
    visible_fractions: Floats
    segmentation: SceneMatches
    explained: SceneMatches
    clutter: ClutterStats
    groups: int
    ms: dict[str, float]
    threads: int
    git_commit: str

    @classmethod
    def of(cls, record: PoseRecord, index: int, part: PartModel, space: PoseSpace | None = None) -> "PoseScore":
        """Judge a record.

        Args:
            record: Of a scene.
            index: The scene's.
            part: What lies in it.
            space: `PoseSpace` of the part, if it is at hand.
        """
        space = space or PoseSpace.of(part)
        distances = recognition_distances(record.poses, record.T_cam_parts, part)
        moved = np.full(distances.shape, np.inf)
        if distances.size:  # without a pose, or a part, there is nothing to represent
            moved = space.distances(record.poses, record.T_cam_parts)
        to_find = visible_enough(record.visible_fractions)

        def deliver(which: NDArray[np.int64]) -> Delivery:
            nearest = MAX_DISTANCE * part.d_max
            bregier = judge_poses(moved[which], record.scores[which], to_find, nearest)
            return _delivery(which, distances[which], record.scores[which], bregier)

        return cls(
            index=index,
            trials=_trials(record, part),
            delivered=deliver(np.flatnonzero(record.verified)),
            every=deliver(np.arange(len(record.scores))),
            scores=record.scores,
            fits=np.asarray(np.isfinite(distances).any(axis=1)),
            to_find=to_find,
            visible_fractions=record.visible_fractions,
            segmentation=_segmentation(record),
            explained=record.segmentation(explained=True).matches(),
            clutter=ClutterStats.from_fractions(record.visible_fractions),
            groups=0 if record.whole_scene else len(record.confidences),
            ms=record.ms,
            threads=record.threads,
            git_commit=record.git_commit,
        )

    @property
    def recall(self) -> float:
        """Share of the parts to find that a delivered pose is right for; NaN without one to find."""
        return float(self.delivered.found[self.to_find].mean()) if self.to_find.any() else np.nan


def load_pose_scores(folder: Path, count: int, part: PartModel) -> list[PoseScore]:
    """Judge the records of scenes 0 to ``count - 1``.

    Raises:
        RecordError: One is missing or damaged.
    """
    space = PoseSpace.of(part)
    return [PoseScore.of(PoseRecord.load(record_path(folder, k)), k, part, space) for k in range(count)]


def _delivery(which: NDArray[np.int64], distances: Floats, scores: Floats, bregier: PoseVerdicts) -> Delivery:
    parts = distances.shape[1]
    verdicts = judge_poses(distances, scores, np.ones(parts, np.bool_), np.inf)
    found = np.zeros(parts, np.bool_)
    found[verdicts.claims[verdicts.correct]] = True
    return Delivery(which=which, right=verdicts.correct, claims=verdicts.claims, found=found, bregier=bregier)


def _segmentation(record: PoseRecord) -> SceneMatches:
    if record.whole_scene:  # its true segments only say what the trials are about
        return match_scene(truth_of(record.instance_ids, record.visible_fractions), [])
    return record.segmentation().matches()


def _trials(record: PoseRecord, part: PartModel) -> TrialScores:
    """Judge each trial by its group's pose; without segments by whichever pose is nearest to the part."""
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
    """Return whether a pose is right, and the errors of the one that is, or else of the nearest [m], [rad]."""
    if T_true is None or len(poses) == 0:
        return False, np.nan, np.nan
    errors = [pose_error(T, T_true, part) for T in poses]
    judged = [(not is_recognised(error, part.d_max), error.translation, error.rotation) for error in errors]
    missed, translation, rotation = min(judged)
    return not missed, translation, rotation


def worst_first(scores: Sequence[PoseScore]) -> list[PoseScore]:
    """Return the scenes by ascending recall, of equal ones by wrong poses; those without a part to find come last."""

    def badness(score: PoseScore) -> tuple[bool, float, int, int]:
        return bool(np.isnan(score.recall)), score.recall, -int((~score.delivered.right).sum()), score.index

    return sorted(scores, key=badness)

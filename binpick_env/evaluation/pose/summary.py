"""From judged scenes to the numbers that are printed; the field names are the JSON's keys."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig
from binpick_env.evaluation.pose.judgement import Delivery, PoseScore
from binpick_env.evaluation.pose.record import STAGES
from binpick_env.evaluation.pose.statistics import (
    METHODS,
    PoseBand,
    ReliabilityBin,
    bootstrap_weights,
    brier,
    calibration_error,
    median,
    ms_per_group,
    pose_counts,
    pose_intervals,
    quotient,
    reliability,
    visible_band,
)
from binpick_env.evaluation.segmentation.summary import BANDS, weights_facts
from binpick_env.scenes.clutter import pooled_clutter
from perception.geometry import Floats
from perception.metrics.average_precision import ap_summary, percentile_interval, weighted_ap
from perception.metrics.matching import SceneMatches
from perception.metrics.pose_recognition import pose_average_precision, pose_precision_recall
from perception.runtime.provenance import command_line, versions

_APS = ("ap", "ap50", "ap75")  # in the order of `weighted_ap`
QUANTILES = {"median": 0.5, "p90": 0.9, "p95": 0.95}
# Table 3 of the paper: recognition rate, then ms of segmentation, of PPF-MEAM and in all, of one scene.
PAPER = {
    "Part A": (0.9833, 2087.0, 1224.0, 3311.0),
    "Part B": (0.9833, 1892.0, 1085.0, 2977.0),
    "Part C": (0.9393, 1528.0, 641.0, 2169.0),
}
NOTE = (
    "Scenes are synthetic, with simulated sensor noise. The paper's are real scenes of other parts, on another machine "
    "with a GTX 1080, and are not public: the two are not the same test."
)


@dataclass(frozen=True, kw_only=True)
class PoseSummary:
    """An evaluation's numbers; NaN where there is nothing to count.

    Attributes:
        recognition_rate: Share of the trials (per scene the three groups nearest to a whole part in their number of
            points) whose pose is within 10 % of d_max and 5 degrees of the part that owns most of the group's points;
            no pose is a failure, and verification removes none.
        trials: Number of trials.
        recall: Share of the parts visible to a half or more that have a right verified pose.
        parts_to_find: Number of these parts.
        precision: Share of the verified poses that are right, for any part; of several for one part one is.
        verified: Number of verified poses.
        unverified: recall, precision and number of poses if all of them were delivered.
        intervals: 95 % of the three.
        interval_methods: How each was made.
        pose_ap: Bregier's average precision of the verified poses, by his distance; unverified_pose_ap: of all poses.
        unverified_pose_ap: See there.
        translation_mm: Quantiles of the recognised trials' error at the part's centre.
        rotation_deg: Quantiles of the recognised trials' error modulo symmetry.
        purity: Median share of a trial group's points on its part.
        by_visible_fraction: Recall by band.
        reliability: What scores are worth.
        calibration_error: Mean of the bins' differences between score and share, by their number of poses.
        brier: Mean square of the difference between a score and 1 or 0.
        ap: ScanNet's average precision of the groups; ap50 and ap75 are those at one IoU; 0 without segments.
        ap50: See there.
        ap75: See there.
        explained: The same three after the poses have explained the points.
        explained_gain: Differences to those before, (value, low, high), 95 % percentile bootstrap over scenes.
        ms_segmentation: Median wall clock from boundary points to groups [ms]; 0 without a network.
        ms_pose: From groups to verified poses, all groups of a scene [ms].
        ms_trials: For the poses of the trials' groups alone [ms].
        ms_per_group: Of ``ms_pose``, for each group [ms].
        ms: Medians of all stages; "total" is from a frame to verified poses.
        groups_per_scene: Median.
        threads: That a scene was computed on.
        clutter: median (mean of the scenes' medians), below_half and above_nine_tenths (shares of all parts), parts.
        scenes: Number of scenes.
        part: What was in the bins.
        sensor: The depth camera's noise.
        seed: Of the scenes.
        perception: Where the segments came from.
        min_score: From which a pose is verified.
        weights: path, sha256 and, of their training: git_commit, parts, steps, minutes, scenes; None without a network.
        paper: Table 3 of the paper: rate, and ms of segmentation, of PPF-MEAM and in all.
        note: How far the two can be compared.
        config: All settings.
        command: Command line of the process that summed up.
        git_commits: Of the code that made the records; more than one if the code changed between them.
        versions: Python, platform and packages.
    """

    recognition_rate: float
    trials: int
    recall: float
    parts_to_find: int
    precision: float
    verified: int
    unverified: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    interval_methods: dict[str, str] = field(default_factory=METHODS.copy)
    pose_ap: float
    unverified_pose_ap: float
    translation_mm: dict[str, float]
    rotation_deg: dict[str, float]
    purity: float
    by_visible_fraction: list[PoseBand]
    reliability: list[ReliabilityBin]
    calibration_error: float
    brier: float
    ap: float
    ap50: float
    ap75: float
    explained: dict[str, float]
    explained_gain: dict[str, tuple[float, float, float]]
    ms_segmentation: float
    ms_pose: float
    ms_trials: float
    ms_per_group: float
    ms: dict[str, float]
    groups_per_scene: float
    threads: list[int]
    clutter: dict[str, float | None]
    scenes: int
    part: str
    sensor: str
    seed: int
    perception: str
    min_score: float
    weights: dict[str, Any] | None
    paper: dict[str, tuple[float, float, float, float]] = field(default_factory=PAPER.copy)
    note: str = NOTE
    config: dict[str, Any]
    command: str = field(default_factory=command_line)
    git_commits: list[str]
    versions: dict[str, str] = field(default_factory=versions)


def summarise_poses(
    config: PoseEvaluationConfig, scores: Sequence[PoseScore], rng: np.random.Generator, resamples: int = 1000
) -> PoseSummary:
    """Sum scenes up.

    Args:
        config: That their records are of.
        scores: Of all scenes.
        rng: The intervals' chance.
        resamples: Of the bootstrap.

    Raises:
        ValueError: There is no scene.
    """
    if not scores:
        raise ValueError("there is nothing to sum up: no scene was evaluated")
    counts = pose_counts(scores)
    sums = counts.sum(axis=0)
    method = config.method
    weights = bootstrap_weights(len(scores), rng, resamples)
    before, after = ([getattr(score, name) for score in scores] for name in ("segmentation", "explained"))
    groups, explained = ap_summary(before), ap_summary(after)
    everything = pose_counts(scores, verified=False).sum(axis=0)
    bins = reliability(scores)
    ms = _times(scores)
    return PoseSummary(
        recognition_rate=quotient(sums[0], sums[1]),
        trials=int(sums[1]),
        recall=quotient(sums[2], sums[3]),
        parts_to_find=int(sums[3]),
        precision=quotient(sums[4], sums[5]),
        verified=int(sums[5]),
        unverified={
            "recall": quotient(everything[2], everything[3]),
            "precision": quotient(everything[4], everything[5]),
            "poses": int(everything[5]),
        },
        intervals=pose_intervals(counts, weights),
        pose_ap=_bregier(scores, lambda score: score.delivered),
        unverified_pose_ap=_bregier(scores, lambda score: score.every),
        translation_mm=_quantiles(1000 * _recognised(scores, "translations")),
        rotation_deg=_quantiles(np.rad2deg(_recognised(scores, "rotations"))),
        purity=median([value for score in scores for value in score.trials.purities]),
        by_visible_fraction=[visible_band(scores, low, high) for low, high in BANDS],
        reliability=bins,
        calibration_error=calibration_error(bins),
        brier=brier(scores),
        ap=groups.ap,
        ap50=groups.ap50,
        ap75=groups.ap75,
        explained={name: getattr(explained, name) for name in _APS},
        explained_gain=_gain(before, after, weights),
        ms_segmentation=median([score.ms["surface"] + score.ms["segmentation"] for score in scores]),
        ms_pose=ms["pose"],
        ms_trials=ms["trials"],
        ms_per_group=ms_per_group(scores),
        ms=ms,
        groups_per_scene=median([score.groups for score in scores]),
        threads=sorted({score.threads for score in scores}),
        clutter=pooled_clutter([score.clutter for score in scores]),
        scenes=len(scores),
        part=config.scenes.part,
        sensor=config.scenes.sensor,
        seed=config.scenes.seed,
        perception=method.perception,
        min_score=method.estimator.min_score,
        weights=None if method.network is None else weights_facts(method.network),
        config=config.note(),
        git_commits=sorted({score.git_commit for score in scores}),
    )


def _gain(
    before: Sequence[SceneMatches], after: Sequence[SceneMatches], weights: Floats
) -> dict[str, tuple[float, float, float]]:
    """Return the differences of the APs that the poses have made, with their intervals."""
    ones = np.ones((1, len(before)))
    value = (weighted_ap(after, ones) - weighted_ap(before, ones))[0]
    drawn = weighted_ap(after, weights) - weighted_ap(before, weights)
    return {name: (float(value[k]), *percentile_interval(drawn[:, k])) for k, name in enumerate(_APS)}


def _times(scores: Sequence[PoseScore]) -> dict[str, float]:
    return {name: median([score.ms[name] for score in scores]) for name in STAGES}


def _recognised(scores: Sequence[PoseScore], name: str) -> Floats:
    """Return one error of all recognised trials."""
    return np.concatenate([getattr(score.trials, name)[score.trials.recognised] for score in scores])


def _quantiles(values: Floats) -> dict[str, float]:
    return {name: float(np.quantile(values, q)) if len(values) else np.nan for name, q in QUANTILES.items()}


def _bregier(scores: Sequence[PoseScore], of: Callable[[PoseScore], Delivery]) -> float:
    return pose_average_precision(pose_precision_recall([of(score).bregier for score in scores]))

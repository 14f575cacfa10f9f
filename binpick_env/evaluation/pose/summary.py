"""Summary of an evaluation of poses; its field names are the keys of the JSON file."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig
from binpick_env.evaluation.pose.record import STAGES
from binpick_env.evaluation.pose.scene_score import PoseMatches, PoseSceneScore
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
from binpick_env.evaluation.segmentation.summary import BANDS, weights_provenance
from binpick_env.scenes.clutter import pooled_clutter
from perception.geometry import Floats
from perception.metrics.average_precision import ap_summary, percentile_interval, weighted_ap
from perception.metrics.matching import SceneMatches
from perception.metrics.pose_recognition import pose_average_precision, pose_precision_recall
from perception.runtime.provenance import command_line, versions

_APS = ("ap", "ap50", "ap75")  # the first columns of `weighted_ap`
QUANTILES = {"median": 0.5, "p90": 0.9, "p95": 0.95}
# Table 3 of the paper: recognition rate; time of segmentation, of PPF-MEAM and in total for one scene [ms].
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
    """Numbers of an evaluation; NaN where there is nothing to count.

    Attributes:
        recognition_rate: Share of the trials (in each scene the three groups whose number of points is nearest to that
            of a whole part) whose pose is within 0.1 d_max and 5 deg of the part that most of the group's points lie
            on. A group without a pose is a failure; verification removes no trial.
        trials: Number of trials.
        recall: Share of the parts with a visible fraction of at least 0.5 that have a correct verified pose.
        parts_to_find: Number of parts with a visible fraction of at least 0.5.
        precision: Share of the verified poses that are correct; of several poses of a part one is correct.
        verified: Number of verified poses.
        unverified: Recall, precision and number of poses if all estimated poses counted.
        intervals: 95 % intervals of recognition rate, recall and precision.
        interval_methods: Method of each interval.
        pose_ap: Bregier's average precision of the verified poses, by his distance.
        unverified_pose_ap: Bregier's average precision of all estimated poses.
        translation_mm: Quantiles of the recognised trials' position error at the part's centre [mm].
        rotation_deg: Quantiles of the recognised trials' rotation error modulo symmetry [deg].
        purity: Median share of a trial group's points that lie on its part.
        by_visible_fraction: Recall by band of visible fractions.
        reliability: Share of correct poses by tenth of the score.
        calibration_error: Mean absolute difference of share and mean score over the bins of ``reliability``, weighted
            by their poses.
        brier: Mean squared difference between a score and 1 for correct, 0 for wrong.
        ap: ScanNet's average precision of the groups; 0 without segments.
        ap50: Average precision of the groups at an IoU of 0.5.
        ap75: Average precision of the groups at an IoU of 0.75.
        explained: ap, ap50 and ap75 of the groups after explanation by the poses.
        explained_gain: Gain of ap, ap50 and ap75 by the explanation, (value, low, high), with the ends of a 95 %
            percentile bootstrap over scenes.
        ms_segmentation: Median time from boundary points to groups [ms]; 0 without a network.
        ms_pose: Median time from all groups of a scene to verified poses [ms].
        ms_trials: Median time of the poses of the trials' groups alone [ms].
        ms_per_group: Median time of the pose of one group [ms].
        ms: Median time of each stage [ms]; "total" is from a frame to verified poses.
        groups_per_scene: Median number of groups in a scene.
        threads: Numbers of threads that scenes were computed on.
        clutter: Median visible fraction (mean of the scenes' medians), shares of parts below 0.5 and above 0.9, and the
            number of parts.
        frame_causes: Number of scenes by the likely causes of lost parts that their frames' reports name.
        scenes: Number of scenes.
        part: Part in the bins.
        sensor: Preset of the depth sensor's noise.
        seed: Seed of the scenes.
        perception: Origin of the segments: "learned", "gt_masks" or "whole_scene".
        min_score: Smallest score of a verified pose.
        weights: Path and SHA-256 of the weights, with commit, parts, steps, minutes and scenes of their training; None
            without a network.
        paper: Table 3 of the paper: recognition rate; time of segmentation, of PPF-MEAM and in total [ms].
        note: How far these numbers and the paper's can be compared.
        config: All settings.
        command: Command line of the process that computed the summary.
        git_commits: Commits of the code that made the records; several if the code changed between them.
        versions: Versions of Python, platform and packages.
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
    frame_causes: dict[str, int] = field(default_factory=dict)
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
    config: PoseEvaluationConfig, scores: Sequence[PoseSceneScore], rng: np.random.Generator, resamples: int = 1000
) -> PoseSummary:
    """Summarise the scores of all scenes.

    Args:
        config: Configuration of the evaluation.
        scores: Score of each scene.
        rng: Random generator of the bootstrap.
        resamples: Number of bootstrap resamples.

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
    unverified = pose_counts(scores, verified=False).sum(axis=0)
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
            "recall": quotient(unverified[2], unverified[3]),
            "precision": quotient(unverified[4], unverified[5]),
            "poses": int(unverified[5]),
        },
        intervals=pose_intervals(counts, weights),
        pose_ap=_bregier(scores, lambda score: score.verified),
        unverified_pose_ap=_bregier(scores, lambda score: score.all_poses),
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
        frame_causes=dict(Counter(name for score in scores for name in score.causes).most_common()),
        scenes=len(scores),
        part=config.scenes.part,
        sensor=config.scenes.sensor,
        seed=config.scenes.seed,
        perception=method.perception,
        min_score=method.estimator.min_score,
        weights=None if method.network is None else weights_provenance(method.network, config.load().part),
        config=config.plain(),
        git_commits=sorted({score.git_commit for score in scores}),
    )


def _gain(
    before: Sequence[SceneMatches], after: Sequence[SceneMatches], weights: Floats
) -> dict[str, tuple[float, float, float]]:
    """Return the gain of each AP by the explanation, with its interval."""
    ones = np.ones((1, len(before)))
    value = (weighted_ap(after, ones) - weighted_ap(before, ones))[0]
    drawn = weighted_ap(after, weights) - weighted_ap(before, weights)
    return {name: (float(value[k]), *percentile_interval(drawn[:, k])) for k, name in enumerate(_APS)}


def _times(scores: Sequence[PoseSceneScore]) -> dict[str, float]:
    return {name: median([score.ms[name] for score in scores]) for name in STAGES}


def _recognised(scores: Sequence[PoseSceneScore], name: str) -> Floats:
    """Return the errors called ``name`` of all recognised trials."""
    return np.concatenate([getattr(score.trials, name)[score.trials.recognised] for score in scores])


def _quantiles(values: Floats) -> dict[str, float]:
    return {name: float(np.quantile(values, q)) if len(values) else np.nan for name, q in QUANTILES.items()}


def _bregier(scores: Sequence[PoseSceneScore], matches: Callable[[PoseSceneScore], PoseMatches]) -> float:
    return pose_average_precision(pose_precision_recall([matches(score).bregier for score in scores]))

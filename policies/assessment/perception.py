"""How well a part is segmented and its poses are found on fresh scenes, in a few numbers."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from binpick_env.evaluation.pose.scene_score import PoseSceneScore
from binpick_env.evaluation.pose.summary import PoseSummary
from perception.metrics.average_precision import bootstrap_ap


@dataclass(frozen=True, kw_only=True)
class PerceptionFacts:
    """How well segmentation and pose estimation work; rates are NaN where there is nothing to count.

    Attributes:
        scenes: Number of scenes.
        ap: ScanNet's average precision of the segments.
        ap50: Average precision at an IoU of 0.5.
        ap75: Average precision at an IoU of 0.75.
        recognition: Share of the recognition trials with a correct pose.
        recall: Share of the parts visible to a half or more that have a correct verified pose.
        precision: Share of the verified poses that are correct.
        trials: Number of recognition trials.
        parts_to_find: Number of parts visible to a half or more.
        verified: Number of verified poses.
        intervals: 95 % intervals of the six rates, by name.
        weights: File name of the segmentation network.
        training: Whether the network was trained on the part ("own"), on its family ("family") or neither
            ("zero-shot").
        clutter: Visible fractions of the parts: median, and the shares below_half and above_nine_tenths.
        ms: Median time from a frame to verified poses [ms].
    """

    scenes: int
    ap: float
    ap50: float
    ap75: float
    recognition: float
    recall: float
    precision: float
    trials: int
    parts_to_find: int
    verified: int
    intervals: dict[str, tuple[float, float]]
    weights: str
    training: str
    clutter: dict[str, float | None]
    ms: float


def perception_facts(
    summary: PoseSummary, scores: Sequence[PoseSceneScore], rng: np.random.Generator
) -> PerceptionFacts:
    """Return the numbers of an evaluation of poses by a network's segments.

    Args:
        summary: Summary of the evaluation.
        scores: Score of each scene.
        rng: Source of the bootstrap of the average precisions.

    Raises:
        ValueError: Perception used no network.
    """
    if summary.weights is None:
        raise ValueError(f"the segments must be a network's, got perception {summary.perception!r}")
    intervals = asdict(bootstrap_ap([score.segmentation for score in scores], rng))
    aps = {name: intervals[name] for name in ("ap", "ap50", "ap75")}
    rates = {"recognition": "recognition_rate", "recall": "recall", "precision": "precision"}
    return PerceptionFacts(
        scenes=summary.scenes,
        ap=summary.ap,
        ap50=summary.ap50,
        ap75=summary.ap75,
        recognition=summary.recognition_rate,
        recall=summary.recall,
        precision=summary.precision,
        trials=summary.trials,
        parts_to_find=summary.parts_to_find,
        verified=summary.verified,
        intervals=aps | {name: summary.intervals[theirs] for name, theirs in rates.items()},
        weights=Path(summary.weights["path"]).name,
        training=summary.weights["training"],
        clutter=summary.clutter,
        ms=summary.ms["total"],
    )

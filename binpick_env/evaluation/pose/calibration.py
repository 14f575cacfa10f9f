"""Fit the coefficients of `perception.pose.verification.confidence` to poses with known ground truth."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from binpick_env.evaluation.pose.record import VERDICT_COLUMNS, PoseRecord
from binpick_env.evaluation.pose.scene_score import PoseSceneScore
from perception.geometry import Floats
from perception.part import PartModel
from perception.pose.verification.confidence import COEFFICIENTS, ConfidenceConfig, confidences, predictors

PENALTY = 1e-4  # weight of the squared coefficients, which keeps the fit finite for separable samples


@dataclass(frozen=True, eq=False, kw_only=True)
class Sample:
    """Sample of estimated poses with their correctness.

    Attributes:
        predictors: (E, 8) predictors of each pose, in the order of
            `perception.pose.verification.confidence.COEFFICIENTS`.
        correct: (E,) bool, whether the pose is correct for some part.
        to_find: (E,) bool, whether the pose is correct for a part with a visible fraction of at least 0.5.
        missed: Number of parts with a visible fraction of at least 0.5 that no pose is correct for.
    """

    predictors: Floats
    correct: NDArray[np.bool_]
    to_find: NDArray[np.bool_]
    missed: int

    @classmethod
    def join(cls, samples: Sequence["Sample"]) -> "Sample":
        """Concatenate samples."""
        return cls(
            predictors=np.concatenate([s.predictors for s in samples]),
            correct=np.concatenate([s.correct for s in samples]),
            to_find=np.concatenate([s.to_find for s in samples]),
            missed=sum(s.missed for s in samples),
        )


def load_sample(folder: Path, part: PartModel, config: ConfidenceConfig | None = None) -> Sample:
    """Load the poses of all records in a folder of `evaluate_poses`.

    Args:
        folder: Folder of the records.
        part: Part that lies in the bins.
        config: Limits to which margins and score drops are clipped; those of the default one unless given.

    Raises:
        FileNotFoundError: There is no record.
        RecordError: A record is damaged.
    """
    paths = sorted(folder.glob("scene_*.npz"))
    if not paths:
        raise FileNotFoundError(f"{folder} holds no records of binpick evaluate-pose")
    return Sample.join([_sample(PoseRecord.load(path), part, config or ConfidenceConfig()) for path in paths])


def _sample(record: PoseRecord, part: PartModel, config: ConfidenceConfig) -> Sample:
    score = PoseSceneScore.from_record(record, 0, part)
    columns = {name: record.verdicts[:, k] for k, name in enumerate(VERDICT_COLUMNS)}
    found = predictors(
        np.column_stack([columns[name] for name in ("edge_score", "support", "violation")]),
        columns["margin"],
        columns["score_drop"],
        np.maximum(columns["size"], 1),
        config,
    )
    matches = score.all_poses
    to_find = np.zeros(len(score.scores), np.bool_)
    to_find[matches.pose_idx] = matches.correct & score.to_find[np.maximum(matches.matched_part, 0)]
    missed = int(np.count_nonzero(score.to_find & ~matches.found))
    return Sample(predictors=found, correct=score.correct, to_find=to_find, missed=missed)


def fit_confidence(sample: Sample, start: ConfidenceConfig | None = None) -> ConfidenceConfig:
    """Fit a logistic regression of correctness by penalised maximum likelihood.

    Args:
        sample: Poses with their correctness.
        start: Configuration whose other settings are kept; the default one unless given.

    Raises:
        ValueError: All poses are correct, or all are wrong.
    """
    start = start or ConfidenceConfig()
    correct = sample.correct
    if correct.all() or not correct.any():
        raise ValueError(f"correct and wrong poses are needed, got {correct.sum()} correct of {len(correct)}")
    X = np.column_stack([np.ones(len(correct)), sample.predictors])
    signs = np.where(correct, 1.0, -1.0)

    def loss(w: Floats) -> tuple[float, Floats]:
        margins = signs * (X @ w)
        weights = np.r_[0.0, w[1:]]
        gradient = -X.T @ (signs / (1 + np.exp(margins))) / len(X)
        return float(np.logaddexp(0, -margins).mean() + PENALTY * weights @ weights), gradient + 2 * PENALTY * weights

    found = minimize(loss, np.zeros(X.shape[1]), jac=True, method="BFGS").x
    names = ("bias", *COEFFICIENTS)
    return replace(start, **{name: round(float(value), 3) for name, value in zip(names, found, strict=True)})


def plain_coefficients(config: ConfidenceConfig) -> dict[str, float]:
    """Return the coefficients by name, for JSON."""
    return asdict(config) | {"firmness": config.score_drop}  # the previous version's name is kept for one version


def predicted_confidence(sample: Sample, config: ConfidenceConfig) -> Floats:
    """Return the (E,) confidence of each pose, in [0, 1]."""
    return confidences(sample.predictors, config)


def operating_points(sample: Sample, config: ConfidenceConfig, scores: Sequence[float]) -> list[tuple[float, ...]]:
    """Return (threshold, number of poses that reach it, their precision, recall) for each threshold in ``scores``."""
    confidence = predicted_confidence(sample, config)
    rows: list[tuple[float, ...]] = []
    for score in scores:
        passed = confidence >= score
        precision = float(sample.correct[passed].mean()) if passed.any() else np.nan
        parts = int(sample.to_find.sum()) + sample.missed
        rows.append((score, int(passed.sum()), precision, float((sample.to_find & passed).sum() / max(parts, 1))))
    return rows

"""Fit the coefficients of `perception.pose.verification.confidence` to poses with known ground truth."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from binpick_env.evaluation.pose.record import DOUBT_COLUMNS, VERDICT_COLUMNS, PoseRecord
from binpick_env.evaluation.pose.scene_score import PoseSceneScore
from perception.geometry import Floats
from perception.part import PartModel
from perception.pose.verification.confidence import (
    COEFFICIENTS,
    ConfidenceConfig,
    confidences,
    mismatch_penalty,
    predictors,
)
from perception.pose.verification.mismatch import Mismatch

MILLIMETRES, DEGREES = 1e3, 180 / np.pi  # in a metre, in a radian; the fit wants coefficients of like size
PENALTY = 1e-4  # weight of the squared coefficients, which keeps the fit finite for separable samples


@dataclass(frozen=True, eq=False, kw_only=True)
class Sample:
    """Sample of estimated poses with their correctness.

    Attributes:
        predictors: (E, 9) predictors of each pose, in the order of
            `perception.pose.verification.confidence.COEFFICIENTS`.
        mismatch: (E,) term that structure which does not match adds to each pose's weighted sum, 0 or less.
        noise: (E,) standard deviation of the depth of each pose's frame [m].
        correct: (E,) bool, whether the pose is correct for some part.
        to_find: (E,) bool, whether the pose is correct for a part with a visible fraction of at least 0.5.
        missed: Number of parts with a visible fraction of at least 0.5 that no pose is correct for.
    """

    predictors: Floats
    mismatch: Floats
    noise: Floats
    correct: NDArray[np.bool_]
    to_find: NDArray[np.bool_]
    missed: int

    @classmethod
    def join(cls, samples: Sequence["Sample"]) -> "Sample":
        """Concatenate samples."""
        return cls(
            predictors=np.concatenate([s.predictors for s in samples]),
            mismatch=np.concatenate([s.mismatch for s in samples]),
            noise=np.concatenate([s.noise for s in samples]),
            correct=np.concatenate([s.correct for s in samples]),
            to_find=np.concatenate([s.to_find for s in samples]),
            missed=sum(s.missed for s in samples),
        )


def load_sample(folder: Path, part: PartModel, config: ConfidenceConfig | None = None) -> Sample:
    """Load the poses of all records in a folder of `evaluate_poses`.

    Args:
        folder: Folder of the records.
        part: Part that lies in the bins.
        config: Limits to which margins and score drops are clipped, and weights of the mismatch; those of the default
            one unless given.

    Raises:
        FileNotFoundError: There is no record.
        RecordError: A record is damaged.
        ValueError: A record is of an older version, without mismatch, noise or expected error.
    """
    paths = sorted(folder.glob("scene_*.npz"))
    if not paths:
        raise FileNotFoundError(f"{folder} holds no records of binpick evaluate-pose")
    records = [PoseRecord.load(path) for path in paths]
    for path, record in zip(paths, records, strict=True):
        if np.isnan(record.doubts).any():
            raise ValueError(
                f"{path} is of an older version, without mismatch, noise or expected error: "
                "run binpick evaluate-pose again"
            )
    return Sample.join([_sample(record, part, config or ConfidenceConfig()) for record in records])


def _sample(record: PoseRecord, part: PartModel, config: ConfidenceConfig) -> Sample:
    score = PoseSceneScore.from_record(record, 0, part)
    columns = {name: record.verdicts[:, k] for k, name in enumerate(VERDICT_COLUMNS)}
    columns |= {name: record.doubts[:, k] for k, name in enumerate(DOUBT_COLUMNS)}
    found = predictors(
        np.column_stack([columns[name] for name in ("edge_score", "support", "violation")]),
        columns["margin"],
        columns["score_drop"],
        np.maximum(columns["size"], 1),
        columns["rotation_error"],
        config,
    )
    mismatches = [Mismatch(patch=p, stray=s) for p, s in zip(columns["patch"], columns["stray"], strict=True)]
    mismatch = [mismatch_penalty(each, 0.0, config) for each in mismatches]
    matches = score.all_poses
    to_find = np.zeros(len(score.scores), np.bool_)
    to_find[matches.pose_idx] = matches.correct & score.to_find[np.maximum(matches.matched_part, 0)]
    missed = int(np.count_nonzero(score.to_find & ~matches.found))
    return Sample(
        predictors=found,
        mismatch=np.array(mismatch, np.float64),
        noise=columns["noise"],
        correct=score.correct,
        to_find=to_find,
        missed=missed,
    )


def fit_confidence(sample: Sample, start: ConfidenceConfig | None = None) -> ConfidenceConfig:
    """Fit a logistic regression of correctness by penalised maximum likelihood.

    The weights of the mismatch are not fitted. The weight of the noise is, if a frame has more than the limit.

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
    excess = MILLIMETRES * np.maximum(sample.noise - start.noise, 0.0)
    if not np.isfinite(excess).all():
        raise ValueError("the noise of every frame must be finite")
    units = np.array([DEGREES if name == "rotation_error" else 1.0 for name in COEFFICIENTS])
    X = np.column_stack([np.ones(len(correct)), sample.predictors * units, excess])
    signs = np.where(correct, 1.0, -1.0)

    def loss(w: Floats) -> tuple[float, Floats]:
        margins = signs * (X @ w + sample.mismatch)
        weights = np.r_[0.0, w[1:]]
        gradient = -X.T @ (signs / (1 + np.exp(margins))) / len(X)
        return float(np.logaddexp(0, -margins).mean() + PENALTY * weights @ weights), gradient + 2 * PENALTY * weights

    found = minimize(loss, np.zeros(X.shape[1]), jac=True, method="BFGS").x
    if found[-1] > 0:  # noise speaks for no pose: the others are fitted without it
        X[:, -1] = 0.0
        found = minimize(loss, np.zeros(X.shape[1]), jac=True, method="BFGS").x
    values = found[:-1] * np.r_[1.0, units]
    fitted = {name: round(float(value), 3) for name, value in zip(("bias", *COEFFICIENTS), values, strict=True)}
    if excess.any():
        fitted["noise_weight"] = min(float(round(MILLIMETRES * float(found[-1]))), 0.0)
    return replace(start, **fitted)


def plain_coefficients(config: ConfidenceConfig) -> dict[str, float]:
    """Return the coefficients by name, for JSON."""
    return asdict(config) | {"firmness": config.score_drop}  # the previous version's name is kept for one version


def predicted_confidence(sample: Sample, config: ConfidenceConfig) -> Floats:
    """Return the (E,) confidence of each pose, in [0, 1]."""
    noise = config.noise_weight * np.maximum(sample.noise - config.noise, 0.0)
    return confidences(sample.predictors, config, sample.mismatch + noise)


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

"""Coefficients of `perception.pose.verification.confidence`, fitted to poses whose truth is known."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from binpick_env.evaluation.pose.record import EVIDENCE, PoseRecord
from binpick_env.evaluation.pose.scene_score import PoseSceneScore
from perception.geometry import Floats
from perception.part import PartModel
from perception.pose.verification.confidence import ConfidenceConfig

PENALTY = 1e-4  # on the square of each coefficient, so that a separable set has an answer too


@dataclass(frozen=True, eq=False, kw_only=True)
class Sample:
    """Poses of groups and whether they are right.

    Attributes:
        predictors: (E, 6) as `perception.pose.verification.confidence.predictors` orders them.
        right: (E,) bool whether the pose is right for some part.
        to_find: (E,) bool whether that part is half visible or more; False for a wrong pose.
        missed: Parts to find that no pose is right for.
    """

    predictors: Floats
    right: NDArray[np.bool_]
    to_find: NDArray[np.bool_]
    missed: int

    @classmethod
    def join(cls, samples: Sequence["Sample"]) -> "Sample":
        """Put samples together."""
        return cls(
            predictors=np.concatenate([s.predictors for s in samples]),
            right=np.concatenate([s.right for s in samples]),
            to_find=np.concatenate([s.to_find for s in samples]),
            missed=sum(s.missed for s in samples),
        )


def load_sample(folder: Path, part: PartModel, clear: float) -> Sample:
    """Return the poses of all records in a folder of `evaluate_poses`.

    Raises:
        FileNotFoundError: There is no record.
        RecordError: One is damaged.
    """
    paths = sorted(folder.glob("scene_*.npz"))
    if not paths:
        raise FileNotFoundError(f"{folder} holds no records of evaluate_pose.py")
    return Sample.join([_sample(PoseRecord.load(path), part, clear) for path in paths])


def _sample(record: PoseRecord, part: PartModel, clear: float) -> Sample:
    score = PoseSceneScore.from_record(record, 0, part)
    columns = {name: record.verdicts[:, k] for k, name in enumerate(EVIDENCE)}
    predictors = np.column_stack(
        [
            *(columns[name] for name in ("edge_score", "support", "violation")),
            *(np.clip(columns[name], -clear, clear) for name in ("margin", "score_drop")),
            np.log(np.maximum(columns["size"], 1)),
        ]
    )
    delivery = score.all_poses
    sought = np.zeros(len(score.scores), np.bool_)
    sought[delivery.pose_idx] = delivery.correct & score.to_find[np.maximum(delivery.matched_part, 0)]
    missed = int(np.count_nonzero(score.to_find & ~delivery.found))
    return Sample(predictors=predictors, right=score.correct, to_find=sought, missed=missed)


def fit_confidence(sample: Sample, start: ConfidenceConfig | None = None) -> ConfidenceConfig:
    """Return the logistic regression of rightness by maximum likelihood.

    Raises:
        ValueError: All poses are right, or all are wrong.
    """
    start = start or ConfidenceConfig()
    if sample.right.all() or not sample.right.any():
        raise ValueError(f"right and wrong poses are needed, got {sample.right.sum()} right of {len(sample.right)}")
    X = np.column_stack([np.ones(len(sample.right)), sample.predictors])
    signs = np.where(sample.right, 1.0, -1.0)

    def loss(w: Floats) -> tuple[float, Floats]:
        margins = signs * (X @ w)
        weights = np.r_[0.0, w[1:]]
        slope = -X.T @ (signs / (1 + np.exp(margins))) / len(X)
        return float(np.logaddexp(0, -margins).mean() + PENALTY * weights @ weights), slope + 2 * PENALTY * weights

    found = minimize(loss, np.zeros(X.shape[1]), jac=True, method="BFGS").x
    names = [field.name for field in fields(start) if field.name != "clear"]
    return replace(start, **{name: round(float(value), 3) for name, value in zip(names, found, strict=True)})


def plain_coefficients(config: ConfidenceConfig) -> dict[str, float]:
    """Return the coefficients by name, for JSON."""
    return asdict(config) | {"firmness": config.score_drop}  # the previous version's name is kept for one version


def predicted(sample: Sample, config: ConfidenceConfig) -> Floats:
    """Return the (E,) confidence of the sample's poses."""
    names = [field.name for field in fields(config) if field.name not in ("bias", "clear")]
    weighted = config.bias + sample.predictors @ np.array([getattr(config, name) for name in names])
    found: Floats = 0.5 * (1 + np.tanh(weighted / 2))
    return found


def operating_points(sample: Sample, config: ConfidenceConfig, scores: Sequence[float]) -> list[tuple[float, ...]]:
    """Return for each smallest score: it, the poses it lets pass, their precision, and the recall."""
    chance = predicted(sample, config)
    rows: list[tuple[float, ...]] = []
    for score in scores:
        passed = chance >= score
        precision = float(sample.right[passed].mean()) if passed.any() else np.nan
        sought = int(sample.to_find.sum()) + sample.missed
        rows.append((score, int(passed.sum()), precision, float((sample.to_find & passed).sum() / max(sought, 1))))
    return rows

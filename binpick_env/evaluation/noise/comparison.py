"""What the perceiver made of one frame, compared with the truth."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from perception.metrics.pose_errors import is_recognised, pose_error


@dataclass(frozen=True, kw_only=True)
class PartObservation:
    """One part in one frame, and the best candidate of it.

    Attributes:
        visible_fraction: True visible fraction, above 0.
        detected: Whether there is a candidate of the part; all other attributes are meaningless if not.
        correct: Whether the candidate's pose is within 0.1 d_max and 5 deg of the true one.
        translation_error: Position error at the part's centre [m].
        rotation_error: Rotation error modulo symmetry [rad].
        score: Confidence of the candidate, in [0, 1].
        estimated_fraction: Visible fraction that the perceiver estimated.
        fill: Number of visible boundary points over P, that of a whole part.
    """

    visible_fraction: float
    detected: bool = False
    correct: bool = False
    translation_error: float = 0.0
    rotation_error: float = 0.0
    score: float = 0.0
    estimated_fraction: float = 0.0
    fill: float = 0.0


@dataclass(frozen=True, kw_only=True)
class FrameObservation:
    """The visible parts of one frame, and the candidates that are not the best one of any part.

    Attributes:
        parts: Visible parts, each with its best candidate.
        false_scores: Confidences of the false and duplicate candidates, in [0, 1].
    """

    parts: tuple[PartObservation, ...]
    false_scores: tuple[float, ...]

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> "FrameObservation":
        """Build an observation from its JSON values."""
        parts = tuple(PartObservation(**each) for each in values["parts"])
        return cls(parts=parts, false_scores=tuple(values["false_scores"]))


def compare_with_truth(view: LabelledCapture, observed: ObservedCandidates) -> FrameObservation:
    """Compare the candidates of a frame with its parts; a part is represented by its candidate of the highest score."""
    parts: list[PartObservation] = []
    matched: set[int] = set()
    for i in np.flatnonzero(view.visible_fractions > 0):
        visible = float(view.visible_fractions[i])
        own = [k for k, candidate in enumerate(observed.candidates) if candidate.part == i]
        if not own:
            parts.append(PartObservation(visible_fraction=visible))
            continue
        best = max(own, key=lambda k: observed.candidates[k].score)
        matched.add(best)
        candidate = observed.candidates[best]
        error = pose_error(candidate.T_world_part, view.T_reported_parts[i], view.part)
        parts.append(
            PartObservation(
                visible_fraction=visible,
                detected=True,
                correct=is_recognised(error, view.part.d_max),
                translation_error=error.translation,
                rotation_error=error.rotation,
                score=float(candidate.score),
                estimated_fraction=float(candidate.visible_fraction),
                fill=float(candidate.fill),
            )
        )
    others = tuple(float(c.score) for k, c in enumerate(observed.candidates) if k not in matched)
    return FrameObservation(parts=tuple(parts), false_scores=others)

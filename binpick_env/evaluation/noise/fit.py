"""Fit of a noise model to the perceiver's candidates in many bins of one part."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.evaluation.noise.comparison import FrameObservation, PartObservation
from binpick_env.observation.noise_statistics import NoiseBin, Spread
from binpick_env.observation.perception_noise import GeneralNoise, PerceptionNoise
from perception.runtime.files import json_text, write_atomically

EDGES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # upper limits of visible fraction
QUANTILES = 11  # number of quantiles that describe a distribution
MIN_POSES = 20  # correct poses that a visibility bin needs for error quantiles of its own


def fit_noise(frames: Sequence[FrameObservation], provenance: dict[str, Any] | None = None) -> PerceptionNoise:
    """Fit the noise model to frames.

    Args:
        frames: Frames whose candidates were compared with the truth.
        provenance: Origin of the frames, which is saved with the model.

    Raises:
        ValueError: The frames hold no correct pose, so that the errors of correct poses are unknown.
    """
    rows = [part for frame in frames for part in frame.parts]
    detected = [row for row in rows if row.detected]
    correct = [row for row in detected if row.correct]
    if not correct:
        raise ValueError(f"{len(frames)} frames hold no correct pose: there is nothing to fit")
    pooled = spread_of(correct)
    scores = [score for frame in frames for score in frame.false_scores]
    return PerceptionNoise(
        bins=tuple(_bin(rows, low, high, pooled) for low, high in zip((0.0, *EDGES), EDGES, strict=False)),
        wrong=spread_of([row for row in detected if not row.correct] or correct),
        false_rate=len(scores) / len(frames),
        false_score=quantiles(scores) if scores else (0.0, 1.0),
        provenance=provenance or {},
    )


def save_noise(path: Path, noise: PerceptionNoise | GeneralNoise) -> None:
    """Write a noise model as JSON, atomically."""
    write_atomically(path, json_text(noise.plain()))


def _bin(rows: Sequence[PartObservation], low: float, high: float, pooled: Spread) -> NoiseBin:
    """Fit one bin of visible fractions in (low, high]; with too few correct poses it has the pooled error quantiles."""
    own = [row for row in rows if low < row.visible_fraction <= high]
    correct = [row for row in own if row.detected and row.correct]
    return noise_bin(high, own, own, spread_of(correct) if len(correct) >= MIN_POSES else pooled)


def noise_bin(
    high: float, seen: Sequence[PartObservation], judged: Sequence[PartObservation], spread: Spread
) -> NoiseBin:
    """Return the statistics of an interval of visible fractions.

    Args:
        high: Upper end of the interval.
        seen: Parts that the share of those with a candidate is counted on.
        judged: Parts on whose candidates everything else is counted.
        spread: Errors and scores of the correct poses.
    """
    detected = [row for row in judged if row.detected]
    correct = [row for row in detected if row.correct]
    bias = np.array([row.estimated_fraction - row.visible_fraction for row in detected]) if detected else np.zeros(1)
    fill = sum(row.fill for row in detected) / sum(row.visible_fraction for row in detected) if detected else 1.0
    return NoiseBin(
        high=high,
        count=len(seen),
        offered=sum(row.detected for row in seen) / max(len(seen), 1),
        wrong=1 - len(correct) / len(detected) if detected else 0.0,
        spread=spread,
        visible_bias=float(bias.mean()),
        visible_sigma=float(bias.std()),
        fill_ratio=fill,
    )


def spread_of(rows: Sequence[PartObservation]) -> Spread:
    """Return the distribution of errors and scores of candidates."""
    return Spread(
        translation=quantiles([row.translation_error for row in rows]),
        rotation=quantiles([row.rotation_error for row in rows]),
        score=quantiles([row.score for row in rows]),
    )


def quantiles(values: Sequence[float]) -> tuple[float, ...]:
    """Return the (Q,) evenly spaced quantiles of values."""
    return tuple(np.quantile(np.asarray(values), np.linspace(0.0, 1.0, QUANTILES)).tolist())

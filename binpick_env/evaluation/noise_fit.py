"""Fit a model of the perceiver's errors to its candidates in many bins."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.env import BinPickEnv
from binpick_env.jobs.process_map import map_indices
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.perception_noise import NOISE_VERSION, NoiseBin, PerceptionNoise, Spread
from binpick_env.options import CellOptions
from perception.metrics.pose_errors import is_recognised, pose_error
from perception.runtime.files import json_text, write_atomically

EDGES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # upper limits of visible fraction
QUANTILES = 11  # number of quantiles that describe a distribution
_MIN_POSES = 20  # correct poses that a visibility bin needs for error quantiles of its own


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


def observe_bins(
    options: CellOptions, bins: int, seed: int, *, num_parts: tuple[int, int], workers: int = 1
) -> list[FrameObservation]:
    """Run the learned perceiver once on each of many settled bins.

    Args:
        options: Part, which needs network weights, bin, camera and sensor.
        bins: Number of bins.
        seed: Seed of all bins; bin i is drawn from (seed, i).
        num_parts: Smallest and largest number of parts in a bin; small numbers represent bins that are nearly empty.
        workers: Number of worker processes.
    """
    observe = partial(_observe_bin, options, num_parts, seed)
    frames = dict(map_indices(observe, range(bins), workers))
    return [frames[index] for index in range(bins)]


_cells: dict[tuple[Any, ...], BinPickEnv] = {}  # environments of this process, each of which takes seconds to build


def _observe_bin(
    options: CellOptions, num_parts: tuple[int, int], seed: int, index: int
) -> tuple[int, FrameObservation]:
    key = (options, num_parts)
    if key not in _cells:
        _cells[key] = BinPickEnv(
            options.load_part(),
            num_parts=num_parts,
            perception="learned",
            sensor=options.sensor,
            config=options.cell(),
            threads=1,
        )
    env = _cells[key]
    env.reset(seed=int(np.random.SeedSequence([seed, index]).generate_state(1)[0]))
    return index, compare_with_truth(env.labelled_capture, env.observed)


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
    pooled = _spread_of(correct)
    scores = [score for frame in frames for score in frame.false_scores]
    return PerceptionNoise(
        bins=tuple(_bin(rows, low, high, pooled) for low, high in zip((0.0, *EDGES), EDGES, strict=False)),
        wrong=_spread_of([row for row in detected if not row.correct] or correct),
        false_rate=len(scores) / len(frames),
        false_score=_quantiles(scores) if scores else (0.0, 1.0),
        provenance=provenance or {},
    )


def save_noise(path: Path, noise: PerceptionNoise) -> None:
    """Write a noise model as JSON, atomically."""
    write_atomically(path, json_text({"version": NOISE_VERSION, **asdict(noise)}))


def _bin(rows: Sequence[PartObservation], low: float, high: float, pooled: Spread) -> NoiseBin:
    """Fit one bin of visible fractions in (low, high]; with too few correct poses it has the pooled error quantiles."""
    own = [row for row in rows if low < row.visible_fraction <= high]
    detected = [row for row in own if row.detected]
    correct = [row for row in detected if row.correct]
    bias = np.array([row.estimated_fraction - row.visible_fraction for row in detected]) if detected else np.zeros(1)
    fill = sum(row.fill for row in detected) / sum(row.visible_fraction for row in detected) if detected else 1.0
    return NoiseBin(
        high=high,
        count=len(own),
        offered=len(detected) / max(len(own), 1),
        wrong=1 - len(correct) / len(detected) if detected else 0.0,
        spread=_spread_of(correct) if len(correct) >= _MIN_POSES else pooled,
        visible_bias=float(bias.mean()),
        visible_sigma=float(bias.std()),
        fill_ratio=fill,
    )


def _spread_of(rows: Sequence[PartObservation]) -> Spread:
    return Spread(
        translation=_quantiles([row.translation_error for row in rows]),
        rotation=_quantiles([row.rotation_error for row in rows]),
        score=_quantiles([row.score for row in rows]),
    )


def _quantiles(values: Sequence[float]) -> tuple[float, ...]:
    return tuple(np.quantile(np.asarray(values), np.linspace(0.0, 1.0, QUANTILES)).tolist())

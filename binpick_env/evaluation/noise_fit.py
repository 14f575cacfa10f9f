"""From what a perceiver made of many bins to the model of its errors."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.config import SensorPreset
from binpick_env.env import BinPickEnv
from binpick_env.jobs.process_map import map_indices
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.perceiver import LabelledCapture
from binpick_env.observation.perception_noise import NOISE_VERSION, NoiseBin, PerceptionNoise, Spread
from perception.metrics.pose_error import is_recognised, pose_error
from perception.runtime.files import json_text, write_atomically

EDGES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)  # upper ends of the bins
QUANTILES = 11
_ENOUGH = 20  # poses from which a bin has a spread of its own


@dataclass(frozen=True, kw_only=True)
class PartObservation:
    """What became of one part in one frame.

    Attributes:
        visible: True visible fraction, above 0.
        offered: Whether there is a candidate of it; without one, what follows means nothing.
        right: Whether its pose is within a tenth of d_max and 5 deg.
        translation: Error at the part's centre [m].
        rotation: Error modulo symmetry [rad].
        score: Confidence.
        seen: Estimated visible fraction.
        fill: Visible boundary points over P.
    """

    visible: float
    offered: bool = False
    right: bool = False
    translation: float = 0.0
    rotation: float = 0.0
    score: float = 0.0
    seen: float = 0.0
    fill: float = 0.0


@dataclass(frozen=True, kw_only=True)
class FrameObservation:
    """What became of the parts of one frame, and the scores of candidates that are no part's, or a part's second."""

    parts: tuple[PartObservation, ...]
    false_scores: tuple[float, ...]


def sight(view: LabelledCapture, observed: ObservedCandidates) -> FrameObservation:
    """Judge the candidates of a frame; of several of one part the best-scored counts."""
    parts: list[PartObservation] = []
    first: set[int] = set()
    for i in np.flatnonzero(view.visible_fractions > 0):
        visible = float(view.visible_fractions[i])
        own = [k for k, candidate in enumerate(observed.candidates) if candidate.part == i]
        if not own:
            parts.append(PartObservation(visible=visible))
            continue
        best = max(own, key=lambda k: observed.candidates[k].score)
        first.add(best)
        candidate = observed.candidates[best]
        error = pose_error(candidate.T_world_part, view.T_reported_parts[i], view.part)
        parts.append(
            PartObservation(
                visible=visible,
                offered=True,
                right=is_recognised(error, view.part.d_max),
                translation=error.translation,
                rotation=error.rotation,
                score=float(candidate.score),
                seen=float(candidate.visible_fraction),
                fill=float(candidate.fill),
            )
        )
    others = tuple(float(c.score) for k, c in enumerate(observed.candidates) if k not in first)
    return FrameObservation(parts=tuple(parts), false_scores=others)


def look_at_bins(
    part: str, bins: int, seed: int, *, sensor: SensorPreset, num_parts: tuple[int, int], workers: int = 1
) -> list[FrameObservation]:
    """Let the learned perceiver look at settled bins of few to many parts, once each.

    Args:
        part: Catalogue name, with weights.
        bins: How many.
        seed: Bin i has numpy's SeedSequence over (seed, i).
        sensor: Depth noise.
        num_parts: Smallest and largest fill; small ones stand for bins that have been picked for a while.
        workers: Processes.
    """
    look = partial(_look, part, sensor, num_parts, seed)
    found = dict(map_indices(look, range(bins), workers))
    return [found[index] for index in range(bins)]


_cells: dict[tuple[Any, ...], BinPickEnv] = {}  # of this process: to build one takes seconds


def _look(
    part: str, sensor: SensorPreset, num_parts: tuple[int, int], seed: int, index: int
) -> tuple[int, FrameObservation]:
    key = (part, sensor, num_parts)
    if key not in _cells:
        _cells[key] = BinPickEnv(part, num_parts=num_parts, perception="learned", sensor=sensor, threads=1)
    env = _cells[key]
    env.reset(seed=int(np.random.SeedSequence([seed, index]).generate_state(1)[0]))
    return index, sight(env.labelled_capture, env.observed)


def fit_noise(frames: Sequence[FrameObservation], provenance: dict[str, Any] | None = None) -> PerceptionNoise:
    """Fit the model to judged frames.

    Raises:
        ValueError: No right pose is among them, so that nothing is known of their errors.
    """
    rows = [part for frame in frames for part in frame.parts]
    offered = [row for row in rows if row.offered]
    right = [row for row in offered if row.right]
    if not right:
        raise ValueError(f"{len(frames)} frames hold no right pose: there is nothing to fit")
    pooled = _spread_of(right)
    scores = [score for frame in frames for score in frame.false_scores]
    return PerceptionNoise(
        bins=tuple(_bin(rows, low, high, pooled) for low, high in zip((0.0, *EDGES), EDGES, strict=False)),
        wrong=_spread_of([row for row in offered if not row.right] or right),
        false_rate=len(scores) / len(frames),
        false_score=_quantiles(scores) if scores else (0.0, 1.0),
        provenance=provenance or {},
    )


def save_noise(path: Path, noise: PerceptionNoise) -> None:
    """Write a model as JSON, in one piece."""
    write_atomically(path, json_text({"version": NOISE_VERSION, **asdict(noise)}))


def _bin(rows: Sequence[PartObservation], low: float, high: float, pooled: Spread) -> NoiseBin:
    own = [row for row in rows if low < row.visible <= high]
    offered = [row for row in own if row.offered]
    right = [row for row in offered if row.right]
    gap = np.array([row.seen - row.visible for row in offered]) if offered else np.zeros(1)
    fill = sum(row.fill for row in offered) / sum(row.visible for row in offered) if offered else 1.0
    return NoiseBin(
        high=high,
        count=len(own),
        offered=len(offered) / max(len(own), 1),
        wrong=1 - len(right) / len(offered) if offered else 0.0,
        spread=_spread_of(right) if len(right) >= _ENOUGH else pooled,
        visible_bias=float(gap.mean()),
        visible_sigma=float(gap.std()),
        fill_ratio=fill,
    )


def _spread_of(rows: Sequence[PartObservation]) -> Spread:
    return Spread(
        translation=_quantiles([row.translation for row in rows]),
        rotation=_quantiles([row.rotation for row in rows]),
        score=_quantiles([row.score for row in rows]),
    )


def _quantiles(values: Sequence[float]) -> tuple[float, ...]:
    return tuple(np.quantile(np.asarray(values), np.linspace(0.0, 1.0, QUANTILES)).tolist())

"""Fit of a noise model for every part to the perceiver's candidates in bins of many parts.

The statistics of a class of parts are its own where it was seen often enough. Otherwise they are those of all parts of
the same shape class, or else those of all parts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from binpick_env.evaluation.noise.bins import ObservedBin
from binpick_env.evaluation.noise.comparison import FrameObservation, PartObservation
from binpick_env.evaluation.noise.fit import MIN_POSES, noise_bin, quantiles, spread_of
from binpick_env.observation.noise_statistics import NoiseBin
from binpick_env.observation.part_class import CLASSES, PartClass
from binpick_env.observation.perception_noise import GeneralNoise, PerceptionNoise

# Upper limits of visible fraction; narrow where the share of parts with a candidate rises steeply.
GENERAL_EDGES = (0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0)
MIN_SEEN = 40  # parts in the frames that a share needs
MIN_FRAMES = 9  # frames that a rate per frame needs
MIN_DESIGNS = 3  # parts of different shape that any statistics need, so that they are not those of one part
DIGITS = 5  # significant digits of what is kept


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """A visible part in a frame, its lengths as shares of ``d_max``."""

    design: str
    part_class: PartClass
    row: PartObservation

    @property
    def correct(self) -> bool:
        return self.row.detected and self.row.correct


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """A frame of one part."""

    design: str
    part_class: PartClass
    frame: FrameObservation


_Item = TypeVar("_Item", _Seen, _Frame)


def fit_general_noise(bins: Sequence[ObservedBin], provenance: dict[str, Any] | None = None) -> GeneralNoise:
    """Fit a noise model for every part.

    Args:
        bins: Observed bins of many parts; those whose pile did not come to rest are left out.
        provenance: Origin of the bins, which is saved with the model.

    Raises:
        ValueError: The bins hold no correct pose, so that the errors of correct poses are unknown.
    """
    frames = [
        _Frame(design=each.part, part_class=each.part_class, frame=each.frame)
        for each in bins
        if each.frame is not None
    ]
    seen = [row for each in bins for row in _in_diameters(each)]
    if not has_correct_pose(bins):
        raise ValueError(f"{len(bins)} bins hold no correct pose: there is nothing to fit")
    fitted = GeneralNoise(classes={each: _of_class(each, seen, frames) for each in CLASSES})
    return replace(GeneralNoise.from_plain(_rounded(fitted.plain())), provenance=provenance or {})


def has_correct_pose(bins: Sequence[ObservedBin]) -> bool:
    """Tell whether there is anything to fit."""
    return any(row.detected and row.correct for each in bins if each.frame is not None for row in each.frame.parts)


def _in_diameters(observed: ObservedBin) -> list[_Seen]:
    if observed.frame is None:
        return []
    d_max, own = observed.signature[0], observed.part_class
    rows = [replace(row, translation_error=row.translation_error / d_max) for row in observed.frame.parts]
    return [_Seen(design=observed.part, part_class=own, row=row) for row in rows]


def _of_class(own: PartClass, seen: Sequence[_Seen], frames: Sequence[_Frame]) -> PerceptionNoise:
    limits = zip((0.0, *GENERAL_EDGES), GENERAL_EDGES, strict=False)
    correct = [each for each in seen if each.correct]
    flawed = [each for each in seen if each.row.detected and not each.row.correct]
    wrong = _enough(own, flawed or correct, bool, MIN_POSES)
    counted = [each.frame for each in _enough(own, frames, bool, MIN_FRAMES)]
    false = [score for frame in counted for score in frame.false_scores]
    mine = [each for each in frames if each.part_class == own]
    return PerceptionNoise(
        bins=tuple(_interval(own, seen, low, high) for low, high in limits),
        wrong=spread_of([each.row for each in wrong]),
        false_rate=len(false) / len(counted),
        false_score=quantiles(false) if false else (0.0, 1.0),
        provenance={"parts": sorted({each.design for each in mine}), "bins": len(mine)},
    )


def _interval(own: PartClass, seen: Sequence[_Seen], low: float, high: float) -> NoiseBin:
    """Fit the parts of a class whose visible fraction is in (low, high]."""
    here = [each for each in seen if low < each.row.visible_fraction <= high]
    shares = _enough(own, here, bool, MIN_SEEN)
    judged = _enough(own, here, lambda each: each.correct, MIN_POSES)
    correct = [each for each in judged if each.correct]
    if len(correct) < MIN_POSES:  # among all parts there are too few in this interval
        correct = [each for each in _enough(own, seen, lambda each: each.correct, MIN_POSES) if each.correct]
    spread = spread_of([each.row for each in correct])
    return noise_bin(high, [each.row for each in shares], [each.row for each in judged], spread)


def _enough(own: PartClass, items: Sequence[_Item], counts: Callable[[_Item], object], needed: int) -> Sequence[_Item]:
    """Return the items of a class, else of its shape class, else all: the first that are enough.

    Args:
        own: Class of parts.
        items: Items of all classes.
        counts: Tells whether an item counts.
        needed: Number of items that must count; they must be of `MIN_DESIGNS` parts, too.
    """
    same_class = [each for each in items if each.part_class == own]
    same_shape = [each for each in items if each.part_class.shape == own.shape]
    for level in (same_class, same_shape):
        counted = [each for each in level if counts(each)]
        if len(counted) >= needed and len({each.design for each in counted}) >= MIN_DESIGNS:
            return level
    return items


def _rounded(values: Any) -> Any:
    """Return JSON values with their floats rounded to `DIGITS` significant digits."""
    if isinstance(values, dict):
        return {key: _rounded(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [_rounded(value) for value in values]
    return float(f"{values:.{DIGITS}g}") if isinstance(values, float) else values

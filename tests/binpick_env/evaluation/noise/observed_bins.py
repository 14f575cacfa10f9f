"""Observed bins of parts that do not exist, whose rates are given."""

import numpy as np

from binpick_env.evaluation.noise.bins import ObservedBin
from binpick_env.evaluation.noise.comparison import FrameObservation, PartObservation
from binpick_env.observation.part_class import ShapeClass

AXES: dict[ShapeClass, tuple[float, float, float]] = {
    "compact": (1.0, 0.9, 0.8),
    "flat": (1.0, 0.9, 0.1),
    "slender": (1.0, 0.2, 0.18),
}  # standard deviations along the principal axes, relative to each other


def signature(shape: ShapeClass, d_max: float) -> tuple[float, ...]:
    """Return the invariants of a part of a shape class and ``d_max`` [m]; area and volume are left at zero."""
    squares = np.square(np.array(AXES[shape]) * d_max / 4)
    return (d_max, 0.0, 0.0, *np.sqrt(squares.sum() - squares))


def row(visible: float = 0.9, *, found: bool = True, correct: bool = True, error: float = 0.001) -> PartObservation:
    """Return a part in a frame; ``error`` is that of its centre [m]."""
    if not found:
        return PartObservation(visible_fraction=visible)
    return PartObservation(
        visible_fraction=visible,
        detected=True,
        correct=correct,
        translation_error=error,
        rotation_error=0.01 if correct else 2.0,
        score=0.9 if correct else 0.4,
        estimated_fraction=visible,
        fill=visible,
    )


def observed(
    part: str,
    shape: ShapeClass,
    rows: list[PartObservation],
    *,
    d_max: float = 0.07,
    false_scores: tuple[float, ...] = (),
) -> ObservedBin:
    """Return a bin of one part, under the standard camera."""
    return ObservedBin(
        part=part,
        signature=signature(shape, d_max),
        d_max_px=d_max * 2400 / 0.9,
        training="zero-shot",
        frame=FrameObservation(parts=tuple(rows), false_scores=false_scores),
    )


def drawn_bins(
    shape: ShapeClass, designs: int, rng: np.random.Generator, *, offered: float, wrong: float
) -> list[ObservedBin]:
    """Return three bins of 20 parts for each of some designs; every other bin has one false candidate."""
    bins = []
    for k in range(3 * designs):
        rows = [
            row(visible, found=bool(rng.random() < offered), correct=bool(rng.random() >= wrong))
            for visible in rng.uniform(0.02, 1.0, 20)
        ]
        bins.append(observed(f"{shape}-{k // 3}", shape, rows, false_scores=(0.5,) * (k % 2)))
    return bins

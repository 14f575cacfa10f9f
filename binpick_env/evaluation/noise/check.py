"""Check of a noise model for every part: on parts that a fit has not seen, are its rates those that were observed?"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from binpick_env.evaluation.noise.bins import ObservedBin
from binpick_env.evaluation.noise.general_fit import fit_general_noise, has_correct_pose
from binpick_env.observation.part_class import ShapeClass
from binpick_env.observation.perception_noise import PerceptionNoise

FOLDS = 5  # number of groups of parts, each of which is left out of a fit once
DRAWS = 20  # number of draws for each part that was seen
ALL = "all"  # name of the row of all parts


@dataclass(frozen=True, kw_only=True)
class ClassRates:
    """Rates of a shape class as observed, and as drawn from models that were fitted to other parts.

    Attributes:
        shape: Shape class, or "all".
        designs: Number of parts of different shape.
        seen: Number of visible parts in all frames.
        offered: Share of them with a candidate: observed, drawn.
        wrong: Share of wrong poses among the candidates: observed, drawn; NaN without candidates.
        false: Candidates of no part in a frame: observed, drawn.
    """

    shape: str
    designs: int
    seen: int
    offered: tuple[float, float]
    wrong: tuple[float, float]
    false: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class _Counts:
    """Counts in one bin: observed, and drawn in `DRAWS` repetitions of its frame."""

    shape: ShapeClass
    design: str
    seen: int
    offered: tuple[int, int]
    wrong: tuple[int, int]
    false: tuple[int, float]


def check_on_left_out_parts(bins: Sequence[ObservedBin], rng: np.random.Generator) -> list[ClassRates]:
    """Compare observed rates with those drawn from models that were fitted without the parts in question.

    The parts are divided into five groups at random. Each group's bins are compared with a model fitted to the other
    groups.

    Args:
        bins: Observed bins of many parts; those whose pile did not come to rest are left out.
        rng: Source of all random numbers.

    Returns:
        Rates by shape class, those of all parts last. Groups of which the others hold no correct pose are left out.
    """
    designs = sorted({each.part for each in bins})
    shuffled = [designs[k] for k in rng.permutation(len(designs))]
    counts: list[_Counts] = []
    for fold in range(min(FOLDS, len(designs))):
        left_out = set(shuffled[fold::FOLDS])
        others = [each for each in bins if each.part not in left_out]
        if has_correct_pose(others):
            noise = fit_general_noise(others)
            own = [each for each in bins if each.part in left_out and each.frame is not None]
            counts += [_counts(each, noise.classes[each.part_class], rng) for each in own]
    shapes = [shape for shape in get_args(ShapeClass) if any(each.shape == shape for each in counts)]
    return [_rates(shape, [each for each in counts if shape in (each.shape, ALL)]) for shape in (*shapes, ALL)]


def _counts(observed: ObservedBin, noise: PerceptionNoise, rng: np.random.Generator) -> _Counts:
    assert observed.frame is not None
    rows, false = observed.frame.parts, observed.frame.false_scores
    fractions = [row.visible_fraction for row in rows for _ in range(DRAWS)]
    drawn = [errors for fraction in fractions if (errors := noise.draw(fraction, rng)) is not None]
    detected = [row for row in rows if row.detected]
    return _Counts(
        shape=observed.part_class.shape,
        design=observed.part,
        seen=len(rows),
        offered=(len(detected), len(drawn)),
        wrong=(sum(not row.correct for row in detected), sum(errors.wrong for errors in drawn)),
        false=(len(false), noise.false_rate),
    )


def _rates(shape: str, counts: Sequence[_Counts]) -> ClassRates:
    seen = sum(each.seen for each in counts)
    offered = [sum(each.offered[k] for each in counts) for k in (0, 1)]
    wrong = [sum(each.wrong[k] for each in counts) for k in (0, 1)]
    false = [sum(each.false[k] for each in counts) for k in (0, 1)]
    return ClassRates(
        shape=shape,
        designs=len({each.design for each in counts}),
        seen=seen,
        offered=(_share(offered[0], seen), _share(offered[1], seen * DRAWS)),
        wrong=(_share(wrong[0], offered[0]), _share(wrong[1], offered[1])),
        false=(_share(false[0], len(counts)), _share(false[1], len(counts))),
    )


def _share(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")

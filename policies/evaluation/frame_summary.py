"""How good perception was in the frames that decisions were made on: its segments and its candidates.

The frames of a bin show the same parts again and again; therefore, intervals come from resampling whole bins.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from binpick_env.evaluation.pose.statistics import bootstrap_weights
from perception.geometry import Floats
from perception.metrics.average_precision import percentile_interval, weighted_ap
from perception.metrics.intervals import wilson_interval
from perception.metrics.matching import SceneMatches
from policies.evaluation.frame_record import FrameRecord, SegmentTable
from policies.evaluation.records import BinRecord
from policies.evaluation.statistics import Interval, bootstrap_ratio

APS = ("ap", "ap50", "ap75")
RATES = ("candidate_pose_accuracy", "candidate_precision", "candidate_recall")
AP_RESAMPLES = 1000


@dataclass(frozen=True, kw_only=True)
class FrameSummary:
    """Perception in the frames that decisions were made on. A number is None where there is nothing to count.

    Attributes:
        ap: ScanNet's "ap", "ap50" and "ap75" of the segments that poses were searched in.
        explained: ScanNet's "ap", "ap50" and "ap75" of the segments after points were assigned to poses.
        rates: The rates of candidates and of parts that `RATES` names.
        counts: Numerator and denominator of each rate.
        errors: Medians over the candidates that have a part: "mm" at its centre, "deg" modulo symmetry.
        stages: Median wall clock of each stage of perception [ms].
        intervals: 95 % intervals of ``ap`` and ``rates``, percentile bootstrap over bins, those of rates at least as
            wide as Wilson's; None for a single bin.
        frames: Number of frames.
        causes: Number of frames by the likely causes of lost parts that their reports name.
    """

    ap: dict[str, float | None]
    explained: dict[str, float | None]
    rates: dict[str, float | None]
    counts: dict[str, tuple[int, int]]
    errors: dict[str, float | None]
    stages: dict[str, float]
    intervals: dict[str, Interval | None]
    frames: int
    causes: dict[str, int] = field(default_factory=dict)


def summarise_frames(records: Sequence[BinRecord], rng: np.random.Generator) -> FrameSummary:
    """Pool the frames of all bins.

    Args:
        records: Records of the bins.
        rng: Random numbers for the bootstrap.

    Note:
        The intervals of an AP take some seconds for 500 frames.
    """
    frames = [frame for record in records for frame in record.frames]
    counts = np.array([frame_counts(record.frames) for record in records]).reshape(-1, len(RATES), 2)
    sums = counts.sum(axis=0).tolist()
    ap, intervals = _segmentation(records, rng)
    intervals |= {name: _rate_interval(counts[:, k], rng) for k, name in enumerate(RATES)}
    return FrameSummary(
        ap=ap,
        explained=_ap([_matches(frame, frame.explained) for frame in frames if frame.explained is not None]),
        rates={name: right / n if n else None for name, (right, n) in zip(RATES, sums, strict=True)},
        counts={name: (right, n) for name, (right, n) in zip(RATES, sums, strict=True)},
        errors=_errors(frames),
        stages={name: float(np.median([f.ms[name] for f in frames if name in f.ms])) for name in _stages(frames)},
        intervals=intervals,
        frames=len(frames),
        causes=dict(Counter(name for frame in frames for name in frame.causes).most_common()),
    )


def over_bins(counts: Floats | Sequence[tuple[int, int]], rng: np.random.Generator) -> Interval | None:
    """Return the 95 % interval of a pooled rate, percentile bootstrap over bins; None for a single bin with trials.

    Args:
        counts: (B, 2) successes and trials of each bin; bins without trials are left out.
        rng: Random numbers for the bootstrap.
    """
    pairs = np.asarray(counts, np.float64).reshape(-1, 2)
    tried = pairs[pairs[:, 1] > 0]
    return bootstrap_ratio(tried[:, 0], tried[:, 1], rng) if len(tried) > 1 else None


def _rate_interval(counts: Floats, rng: np.random.Generator) -> Interval | None:
    """Return the interval over bins, widened to Wilson's, which takes all trials for independent.

    Wrong poses are few: if no bin has any, the bootstrap's interval would have no width.
    """
    drawn = over_bins(counts, rng)
    if drawn is None:
        return None
    low, high = wilson_interval(*counts.sum(axis=0).tolist())
    return min(low, drawn[0]), max(high, drawn[1])


def frame_counts(frames: Iterable[FrameRecord]) -> list[tuple[int, int]]:
    """Return numerator and denominator of each of `RATES` over some frames."""
    frames = list(frames)
    candidates = [candidate for frame in frames for candidate in frame.candidates]
    return [
        (sum(candidate.right for candidate in candidates), len(candidates)),
        (sum(candidate.found >= 0 for candidate in candidates), len(candidates)),
        (sum(len(frame.found) for frame in frames), sum(len(frame.to_find) for frame in frames)),
    ]


def _segmentation(
    records: Sequence[BinRecord], rng: np.random.Generator
) -> tuple[dict[str, float | None], dict[str, Interval | None]]:
    """Return the APs of the segments and their intervals over bins."""
    matches, of_bin = _segment_matches(records)
    ap = _ap(matches)
    if ap["ap"] is None or len(records) < 2:
        return ap, dict.fromkeys(APS)
    weights = bootstrap_weights(len(records), rng, AP_RESAMPLES)[:, of_bin]
    drawn = weighted_ap(matches, weights)
    return ap, {name: percentile_interval(drawn[:, k]) for k, name in enumerate(APS)}


def paired_ap(
    first: Sequence[BinRecord], second: Sequence[BinRecord], rng: np.random.Generator
) -> tuple[float, float, float, float]:
    """Return the segments' APs in two evaluations of the same bins, and the interval of their difference.

    Args:
        first: Records of the first evaluation.
        second: Records of the same bins in the second evaluation, in the same order.
        rng: Random numbers for the bootstrap; each bin is drawn with both of its records.

    Returns:
        First AP, second AP, and the 95 % interval of second minus first, percentile bootstrap over bins; NaN where
        nothing is segmented, and the interval's ends for a single bin.
    """
    weights = bootstrap_weights(len(first), rng, AP_RESAMPLES)
    values, drawn = [], []
    for records in (first, second):
        matches, of_bin = _segment_matches(records)
        ap = _ap(matches)["ap"]
        values.append(np.nan if ap is None else ap)
        if not np.isnan(values[-1]) and len(first) > 1:
            drawn.append(weighted_ap(matches, weights[:, of_bin])[:, 0])
    if len(drawn) < 2:
        return values[0], values[1], np.nan, np.nan
    return values[0], values[1], *percentile_interval(drawn[1] - drawn[0])


def _segment_matches(records: Sequence[BinRecord]) -> tuple[list[SceneMatches], list[int]]:
    """Return the matched segments of every segmented frame, and the position of its bin in ``records``."""
    matches, of_bin = [], []
    for b, record in enumerate(records):
        for frame in record.frames:
            if frame.segments is not None:
                matches.append(_matches(frame, frame.segments))
                of_bin.append(b)
    return matches, of_bin


def _matches(frame: FrameRecord, table: SegmentTable) -> SceneMatches:
    return table.matches(frame.visible_fractions)


def _ap(matches: Sequence[SceneMatches]) -> dict[str, float | None]:
    if not matches:
        return dict.fromkeys(APS)
    values = weighted_ap(matches, np.ones((1, len(matches))))[0].tolist()
    return {name: None if np.isnan(value) else value for name, value in zip(APS, values, strict=False)}


def _errors(frames: Sequence[FrameRecord]) -> dict[str, float | None]:
    known = [
        (1000 * candidate.translation, float(np.degrees(candidate.rotation)))
        for frame in frames
        for candidate in frame.candidates
        if candidate.translation is not None and candidate.rotation is not None
    ]
    if not known:
        return {"mm": None, "deg": None}
    mm, deg = np.median(known, axis=0).tolist()
    return {"mm": mm, "deg": deg}


def _stages(frames: Sequence[FrameRecord]) -> list[str]:
    return list(dict.fromkeys(name for frame in frames for name in frame.ms))


def causes_text(causes: Mapping[str, int], frames: int) -> str:
    """Return the likely causes of lost parts in words, and in how many of all frames each was found."""
    counts = ", ".join(f"{name.replace('_', ' ')} in {count}" for name, count in causes.items())
    return f"{counts} of {frames} frames"

"""Segments and candidates, summarised over bins."""

from typing import Any

import numpy as np
import pytest

from perception.instance import instances_of
from perception.metrics.average_precision import ap_summary
from perception.metrics.intervals import wilson_interval
from perception.metrics.matching import match_scene
from perception.segmentation.scoring import truth_of
from policies.evaluation.frame_record import CandidateRecord, FrameRecord, SegmentTable
from policies.evaluation.frame_summary import FrameSummary, over_bins, summarise_frames
from policies.evaluation.records import BinRecord
from policies.grasping.outcomes import GraspOutcome
from tests.policies.fake_cell import attempt, bin_result


def record(*frames: FrameRecord) -> BinRecord:
    facts: dict[str, Any] = {"config_hash": "", "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
    return BinRecord.from_result(bin_result(attempt(GraspOutcome.DELIVERED)), [""], frames, **facts)


def summary_of(*records: BinRecord) -> FrameSummary:
    return summarise_frames(records, np.random.default_rng(0))


def compared(part: int, right: bool = True, found: int | None = None, mm: float = 1.0) -> CandidateRecord:
    return CandidateRecord(
        part=part,
        score=0.9,
        right=right,
        found=(part if right else -1) if found is None else found,
        translation=None if part < 0 else mm / 1000,
        rotation=None if part < 0 else np.radians(2 * mm),
    )


def frame(*candidates: CandidateRecord, fractions: tuple[float, ...] = (1.0, 1.0), **facts: Any) -> FrameRecord:
    return FrameRecord(frame_id=0, visible_fractions=fractions, candidates=candidates, **facts)


def segmented(rng: np.random.Generator, noise: float) -> tuple[FrameRecord, Any]:
    """Return a frame of five parts with a share of wrong points in its segments, and its matches from the points."""
    part_ids = rng.integers(-1, 5, 1200)
    labels = np.where(rng.random(1200) < noise, rng.integers(-1, 5, 1200), part_ids)
    fractions, instances = (0.05, 0.2, 0.5, 0.9, 1.0), instances_of(labels, rng.random(5))
    table = SegmentTable.count(instances, part_ids)
    matches = match_scene(truth_of(part_ids, np.array(fractions)), instances)
    return frame(fractions=fractions, segments=table, explained=table), matches


def test_ap_is_that_of_all_frames_of_all_bins_pooled() -> None:
    rng = np.random.default_rng(3)
    made = [segmented(rng, noise) for noise in (0.1, 0.3, 0.5, 0.6)]
    summary = summary_of(record(made[0][0], made[1][0], made[2][0]), record(made[3][0]))
    whole = ap_summary([matches for _, matches in made])
    assert 0.05 < whole.ap < 0.95
    assert summary.ap == pytest.approx({"ap": whole.ap, "ap50": whole.ap50, "ap75": whole.ap75})
    assert summary.explained == summary.ap
    assert summary.frames == 4


def test_the_intervals_of_an_ap_draw_whole_bins() -> None:
    rng = np.random.default_rng(3)
    good, bad = segmented(rng, 0.05), segmented(rng, 0.6)
    summary = summary_of(record(good[0], good[0], good[0]), record(bad[0], bad[0], bad[0]))
    ends = [ap_summary([matches]).ap for _, matches in (bad, good)]
    assert summary.intervals["ap"] == pytest.approx(ends)  # of two bins every fourth draw is one of them twice
    alike = summary_of(*[record(good[0], bad[0])] * 3).intervals["ap"]
    assert alike == pytest.approx([ap_summary([good[1], bad[1]]).ap] * 2)  # every bin alike, though frames are not


def test_rates_of_candidates_and_parts() -> None:
    first = frame(compared(0), compared(0, found=-1), compared(1, right=False))  # found, its duplicate, a wrong one
    second = frame(compared(1), compared(-1, right=False), fractions=(0.9, 0.4))  # part 1 need not be found
    summary = summary_of(record(first), record(second))
    assert summary.counts == {
        "candidate_pose_accuracy": (3, 5),
        "candidate_precision": (2, 5),
        "candidate_recall": (1, 3),
    }
    assert summary.rates["candidate_recall"] == 1 / 3


def test_the_interval_of_a_rate_draws_whole_bins_but_is_never_narrower_than_wilsons() -> None:
    good, bad = frame(*[compared(0)] * 100), frame(*[compared(0, right=False)] * 100)
    apart = summary_of(*[record(good)] * 5, *[record(bad)] * 5).intervals["candidate_pose_accuracy"]
    alike = summary_of(*[record(good, bad)] * 10).intervals["candidate_pose_accuracy"]
    perfect = summary_of(*[record(good)] * 10).intervals["candidate_pose_accuracy"]
    assert alike == pytest.approx(wilson_interval(1000, 2000))
    assert perfect == wilson_interval(1000, 1000)
    assert apart is not None
    assert apart == pytest.approx((0.2, 0.8), abs=0.01)  # 10 independent bins, not 1000 candidates


def test_errors_are_medians_over_candidates_with_a_part() -> None:
    far = frame(compared(0, mm=1.0), compared(1, mm=2.0), compared(-1, right=False), compared(1, right=False, mm=50.0))
    assert summary_of(record(far)).errors == pytest.approx({"mm": 2.0, "deg": 4.0})


def test_causes_are_counted_over_frames() -> None:
    frames = [frame(causes=("few_pixels",)), frame(causes=("few_pixels", "underexposed")), frame()]
    summary = summarise_frames([record(*frames[:2]), record(frames[2])], np.random.default_rng(0))
    assert summary.causes == {"few_pixels": 2, "underexposed": 1}


def test_stages_are_medians_over_frames() -> None:
    times = [frame(ms={"boundary": ms, "poses": 300.0}) for ms in (10.0, 20.0, 60.0)]
    assert summary_of(record(*times), record(frame())).stages == {"boundary": 20.0, "poses": 300.0}


def test_what_does_not_exist_is_none() -> None:
    oracle = summary_of(record(frame(compared(0))))
    assert oracle.ap == {"ap": None, "ap50": None, "ap75": None}
    assert oracle.rates["candidate_pose_accuracy"] == 1.0
    assert set(oracle.intervals.values()) == {None}  # a single bin says nothing about bins
    nothing = summary_of(record())
    assert (set(nothing.rates.values()), set(nothing.errors.values()), nothing.frames) == ({None}, {None}, 0)


def test_frames_without_a_part_to_find_have_no_ap() -> None:
    empty = frame(fractions=(), segments=SegmentTable(scores=(), points=()))
    summary = summary_of(record(empty), record(empty))
    assert (set(summary.ap.values()), summary.intervals["ap"]) == ({None}, None)


def test_bins_without_trials_are_not_drawn() -> None:
    assert over_bins([(1, 2), (0, 0)], np.random.default_rng(0)) is None
    assert over_bins([(1, 2), (0, 0), (2, 4)], np.random.default_rng(0)) == (0.5, 0.5)

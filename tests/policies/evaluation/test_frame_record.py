"""A frame compared with the ground truth."""

import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from binpick_env.candidates import MAX_CANDIDATES
from binpick_env.observation.observed_candidates import ObservedCandidates
from perception.diagnosis import Cause, FrameReport
from perception.geometry import make_transform, rotation_about
from perception.instance import instances_of
from perception.metrics.average_precision import ap_summary
from perception.metrics.matching import SceneMatches, match_scene
from perception.runtime.files import json_text
from perception.segmentation.scoring import truth_of
from policies.evaluation.frame_record import FrameRecord, SegmentTable, record_frame
from tests.policies.fake_cell import BLOCK, candidate, labelled_capture, observed

FRACTIONS = np.array([0.9, 0.5, 0.49, 0.0])


def shifted(share: float) -> Any:
    """Return a translation along the diagonal, by a share of d_max."""
    return make_transform(translation=share * BLOCK.d_max / np.sqrt(3) * np.ones(3))


def turned(degrees: float) -> Any:
    return make_transform(rotation_about((0.0, 0.0, 1.0), np.radians(degrees)))


def verdicts(matches: SceneMatches) -> list[tuple[int, float, bool]]:
    return sorted(zip(matches.overlap_idx.tolist(), matches.scores.tolist(), matches.correct.tolist(), strict=True))


# --- segments ------------------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.integers(0, 6), st.integers(0, 6))
def test_a_table_gives_the_same_matches_as_the_points(seed: int, groups: int, parts: int) -> None:
    rng = np.random.default_rng(seed)
    part_ids = rng.integers(-1, max(parts, 1), 900) if parts else np.full(900, -1)
    wander = rng.random(900) < rng.choice([0.05, 0.3, 0.9])
    labels = np.where(wander, rng.integers(-1, max(groups, 1), 900), part_ids)
    labels = np.where(labels < groups, labels, -1)
    scores, fractions = np.sort(rng.choice([0.2, 0.5, 0.9], groups))[::-1], rng.uniform(0.0, 0.3, parts)
    instances = instances_of(labels, scores)
    truth = truth_of(part_ids, fractions)
    table = SegmentTable.count(instances, part_ids)
    direct, kept = match_scene(truth, instances), table.matches(fractions.tolist())
    assert verdicts(kept) == verdicts(direct)
    assert kept.truth_counts == direct.truth_counts


@pytest.mark.parametrize("point", [(1, 0, 5), (-2, 0, 5), (0, -2, 5), (0, 0, 0)])
def test_points_of_a_segment_that_does_not_exist_are_refused(point: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match=r"points must be .* with a segment from -1 to 0, got \("):
        SegmentTable(scores=(0.5,), points=(point,))


def test_the_ground_truth_scores_one_and_no_segment_scores_zero() -> None:
    part_ids = np.repeat([0, 1, -1], [150, 120, 50])
    perfect = SegmentTable.count(instances_of(part_ids, [0.9, 0.8]), part_ids)
    assert ap_summary([perfect.matches([1.0, 1.0])]).ap == 1.0
    assert ap_summary([SegmentTable.count([], part_ids).matches([1.0, 1.0])]).ap == 0.0


# --- candidates ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "right"),
    [
        (np.eye(4), True),
        (shifted(0.099), True),
        (shifted(0.101), False),
        (turned(4.9), True),
        (turned(5.1), False),
        (turned(179.0), False),  # the block declares no symmetry
    ],
)
def test_a_pose_is_correct_by_the_papers_criterion(error: Any, right: bool) -> None:
    view = labelled_capture(FRACTIONS)
    (record,) = record_frame(0, view, ObservedCandidates(candidates=[candidate(view, 0, error)])).candidates
    assert (record.right, record.found) == (right, 0 if right else -1)
    assert record.translation == pytest.approx(np.linalg.norm(error[:3, 3]), abs=1e-12)
    angle = np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1))
    assert record.rotation == pytest.approx(angle, abs=1e-6)


def test_poses_are_compared_under_the_reported_camera_pose() -> None:
    seen = replace(labelled_capture(FRACTIONS[:2]), hand_eye=np.array([0.6 * BLOCK.d_max, 0.0, 0.0]))
    off = make_transform(translation=seen.hand_eye)
    where_reported = [candidate(seen, part, off) for part in (0, 1)]
    record = record_frame(0, seen, ObservedCandidates(candidates=where_reported))
    assert [(c.right, c.found) for c in record.candidates] == [(True, 0), (True, 1)]
    where_true = [candidate(seen, part) for part in (0, 1)]
    record = record_frame(0, seen, ObservedCandidates(candidates=where_true))
    assert [(c.right, c.found) for c in record.candidates] == [(False, -1), (False, -1)]


def test_of_two_correct_poses_the_one_with_the_higher_score_counts_as_found() -> None:
    view = labelled_capture(FRACTIONS)
    candidates = [candidate(view, 0, shifted(0.05), score=0.6), candidate(view, 0, shifted(0.09), score=0.8)]
    record = record_frame(0, view, ObservedCandidates(candidates=candidates))
    assert [each.right for each in record.candidates] == [True, True]
    assert [each.found for each in record.candidates] == [-1, 0]


def test_parts_to_find_are_half_visible_and_parts_out_of_play_are_never_found() -> None:
    view = labelled_capture(FRACTIONS)
    record = record_frame(7, view, ObservedCandidates(candidates=[candidate(view, k) for k in (1, 2, 3)]))
    assert [each.found for each in record.candidates] == [1, 2, -1]
    assert (record.frame_id, record.to_find, record.found) == (7, {0, 1}, {1})
    assert record.visible_fractions == (0.9, 0.5, 0.49, 0.0)


def test_a_correct_pose_of_another_part_is_wrong_for_its_own() -> None:
    view = labelled_capture(FRACTIONS)
    stray = make_transform(translation=view.T_world_parts[1][:3, 3] - view.T_world_parts[0][:3, 3])
    (record,) = record_frame(0, view, ObservedCandidates(candidates=[candidate(view, 0, stray)])).candidates
    assert (record.part, record.right, record.found) == (0, False, 1)
    assert record.translation == pytest.approx(0.07)


def test_without_pixels_nothing_is_segmented_and_no_segment_is_bad() -> None:
    view = labelled_capture(FRACTIONS)
    record = record_frame(0, view, ObservedCandidates(candidates=[candidate(view, 0)]))
    assert (record.segments, record.explained, record.ms) == (None, None, {})
    assert record.candidates[0].overlap is None
    assert record.candidates[0].well_segmented


def test_only_candidates_of_the_observation_are_recorded() -> None:
    view = labelled_capture(FRACTIONS)
    candidates = [candidate(view, 0) for _ in range(MAX_CANDIDATES + 3)]
    assert len(record_frame(0, view, ObservedCandidates(candidates=candidates)).candidates) == MAX_CANDIDATES
    groups = [[k] for k in range(MAX_CANDIDATES + 3)]
    assert len(record_frame(0, view, observed(view, groups, candidates)).candidates) == MAX_CANDIDATES


def test_an_empty_frame_has_no_candidates() -> None:
    view = labelled_capture(np.empty(0))
    record = record_frame(0, view, observed(view, [], []))
    assert (record.candidates, record.to_find, record.found) == ((), frozenset(), frozenset())


def test_the_overlap_is_that_of_the_segment_in_which_the_pose_was_found() -> None:
    ids = np.full(320, -1)
    ids[:100], ids[100:140] = 0, 1
    view = labelled_capture(FRACTIONS, ids)
    good, bad, nowhere = list(range(80)), [*range(130, 140), *range(90, 100)], list(range(200, 260))
    candidates = [candidate(view, 1), candidate(view, 0), candidate(view, 0)]
    record = record_frame(0, view, observed(view, [good, bad, nowhere], candidates, of=[1, 0, 2]))
    assert [each.overlap for each in record.candidates] == [10 / 50, 80 / 100, 0.0]
    assert [each.well_segmented for each in record.candidates] == [False, True, False]
    assert record.segments is not None
    assert record.segments.scores == pytest.approx((0.9, 0.8, 0.7))
    assert record.explained is not None
    assert len(record.explained.scores) == 1
    assert record.ms == {"boundary": 20.0, "segmentation": 60.0}


def test_the_overlap_of_a_pose_in_what_another_left_over_is_that_of_these_points() -> None:
    ids = np.full(320, -1)
    ids[:100], ids[100:200] = 0, 1
    view = labelled_capture(FRACTIONS, ids)
    merged, remainder = list(range(200)), list(range(110, 200))
    seen = observed(view, [merged, remainder], [candidate(view, 0), candidate(view, 1)])
    assert seen.perception is not None
    perception = replace(seen.perception, segments=seen.perception.segments[:1])
    record = record_frame(0, view, replace(seen, perception=perception))
    assert [each.overlap for each in record.candidates] == [100 / 200, 90 / 100]
    assert record.segments is not None
    assert len(record.segments.scores) == 1


def test_a_segment_with_an_iou_of_half_is_good() -> None:
    ids = np.full(320, -1)
    ids[:100] = 0
    view = labelled_capture(FRACTIONS, ids)
    for points, good in ((50, True), (49, False)):
        record = record_frame(0, view, observed(view, [list(range(points))], [candidate(view, 0)]))
        assert record.candidates[0].well_segmented == good


def test_a_record_survives_json() -> None:
    view = labelled_capture(FRACTIONS, 0)
    for seen in (
        ObservedCandidates(candidates=[candidate(view, 2)]),
        observed(view, [[0, 1], [5]], [candidate(view, 0)]),
    ):
        record = record_frame(3, view, seen)
        assert FrameRecord.from_plain(json.loads(json_text(asdict(record)))) == record


def test_the_causes_of_a_frames_report_are_recorded_and_older_records_have_none() -> None:
    view = labelled_capture(FRACTIONS)
    seen = observed(view, [], [])
    assert seen.perception is not None
    report = FrameReport(
        pixels=9, depth_share=1.0, median_depth=0.9, boundary_points=0, outside=0, part_pixels=60.0, poses=None,
        causes=(Cause(name="few_pixels", text="small"),),
    )  # fmt: skip
    record = record_frame(0, view, replace(seen, perception=replace(seen.perception, report=report)))
    assert record.causes == ("few_pixels",)
    plain = json.loads(json.dumps(asdict(record)))
    assert FrameRecord.from_plain(plain).causes == ("few_pixels",)
    del plain["causes"]
    assert FrameRecord.from_plain(plain).causes == ()

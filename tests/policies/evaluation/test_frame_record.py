"""What is kept of a judged frame."""

import json
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from binpick_env.candidates import MAX_CANDIDATES
from binpick_env.observation.observed_candidates import ObservedCandidates
from perception.geometry import make_transform, rotation_about
from perception.instance import instances_of
from perception.metrics.average_precision import ap_summary
from perception.metrics.matching import SceneMatches, match_scene
from perception.runtime.files import json_text
from perception.segmentation.scoring import truth_of
from policies.evaluation.frame_record import FrameRecord, SegmentTable, judge_frame
from tests.policies.fake_cell import BLOCK, candidate, labelled_capture, observed

FRACTIONS = np.array([0.9, 0.5, 0.49, 0.0])


def shifted(share: float) -> Any:
    """An error of a share of d_max along the diagonal."""
    return make_transform(translation=share * BLOCK.d_max / np.sqrt(3) * np.ones(3))


def turned(degrees: float) -> Any:
    return make_transform(rotation_about((0.0, 0.0, 1.0), np.radians(degrees)))


def verdicts(matches: SceneMatches) -> list[tuple[int, float, bool]]:
    return sorted(zip(matches.overlap_idx.tolist(), matches.scores.tolist(), matches.correct.tolist(), strict=True))


# --- segments ------------------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.integers(0, 6), st.integers(0, 6))
def test_a_table_gives_the_verdicts_of_the_points_themselves(seed: int, groups: int, parts: int) -> None:
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


def test_the_overlap_is_the_intersection_over_the_union() -> None:
    # Group 0: 30 points on part 2, 10 on part 0, 5 on the container; 20 points of part 2 are in no group.
    table = SegmentTable(scores=(0.9,), points=((-1, 2, 20), (0, -1, 5), (0, 0, 10), (0, 2, 30)))
    assert table.overlap(0, 2) == 30 / 65
    assert table.overlap(0, 0) == 10 / 45
    assert table.overlap(0, 1) == 0.0


@pytest.mark.parametrize("point", [(1, 0, 5), (-2, 0, 5), (0, -2, 5), (0, 0, 0)])
def test_points_of_no_group_are_refused(point: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match=r"points must be of 1 groups, got \("):
        SegmentTable(scores=(0.5,), points=(point,))


def test_the_truth_as_prediction_is_perfect_and_nothing_is_nothing() -> None:
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
def test_a_pose_is_right_by_the_papers_criterion(error: Any, right: bool) -> None:
    view = labelled_capture(FRACTIONS)
    (judged,) = judge_frame(0, view, ObservedCandidates(candidates=[candidate(view, 0, error)])).candidates
    assert (judged.right, judged.found) == (right, 0 if right else -1)
    assert judged.translation == pytest.approx(np.linalg.norm(error[:3, 3]), abs=1e-12)
    angle = np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1))
    assert judged.rotation == pytest.approx(angle, abs=1e-6)


def test_poses_are_judged_by_the_cameras_reported_place() -> None:
    seen = replace(labelled_capture(FRACTIONS[:2]), hand_eye=np.array([0.6 * BLOCK.d_max, 0.0, 0.0]))
    off = make_transform(translation=seen.hand_eye)
    where_reported = [candidate(seen, part, off) for part in (0, 1)]
    judged = judge_frame(0, seen, ObservedCandidates(candidates=where_reported))
    assert [(c.right, c.found) for c in judged.candidates] == [(True, 0), (True, 1)]
    where_true = [candidate(seen, part) for part in (0, 1)]
    judged = judge_frame(0, seen, ObservedCandidates(candidates=where_true))
    assert [(c.right, c.found) for c in judged.candidates] == [(False, -1), (False, -1)]


def test_of_two_right_poses_of_a_part_the_better_scored_has_found_it() -> None:
    view = labelled_capture(FRACTIONS)
    told = [candidate(view, 0, shifted(0.05), score=0.6), candidate(view, 0, shifted(0.09), score=0.8)]
    judged = judge_frame(0, view, ObservedCandidates(candidates=told))
    assert [each.right for each in judged.candidates] == [True, True]
    assert [each.found for each in judged.candidates] == [-1, 0]


def test_only_parts_half_visible_have_to_be_found_and_those_out_of_play_cannot_be() -> None:
    view = labelled_capture(FRACTIONS)
    judged = judge_frame(7, view, ObservedCandidates(candidates=[candidate(view, k) for k in (1, 2, 3)]))
    assert [each.found for each in judged.candidates] == [1, 2, -1]
    assert (judged.frame_id, judged.to_find, judged.found) == (7, {0, 1}, {1})
    assert judged.visible_fractions == (0.9, 0.5, 0.49, 0.0)


def test_a_pose_that_is_right_for_another_part_is_not_right_for_its_own() -> None:
    view = labelled_capture(FRACTIONS)
    stray = make_transform(translation=view.T_world_parts[1][:3, 3] - view.T_world_parts[0][:3, 3])
    (judged,) = judge_frame(0, view, ObservedCandidates(candidates=[candidate(view, 0, stray)])).candidates
    assert (judged.part, judged.right, judged.found) == (0, False, 1)
    assert judged.translation == pytest.approx(0.07)


def test_without_pixels_nothing_is_segmented_and_no_segment_is_bad() -> None:
    view = labelled_capture(FRACTIONS)
    judged = judge_frame(0, view, ObservedCandidates(candidates=[candidate(view, 0)]))
    assert (judged.segments, judged.explained, judged.ms) == (None, None, {})
    assert judged.candidates[0].overlap is None
    assert judged.candidates[0].well_segmented


def test_only_what_is_offered_is_judged() -> None:
    view = labelled_capture(FRACTIONS)
    told = [candidate(view, 0) for _ in range(MAX_CANDIDATES + 3)]
    assert len(judge_frame(0, view, ObservedCandidates(candidates=told)).candidates) == MAX_CANDIDATES
    groups = [[k] for k in range(MAX_CANDIDATES + 3)]
    assert len(judge_frame(0, view, observed(view, groups, told)).candidates) == MAX_CANDIDATES


def test_an_empty_frame_has_nothing_to_judge() -> None:
    view = labelled_capture(np.empty(0))
    judged = judge_frame(0, view, observed(view, [], []))
    assert (judged.candidates, judged.to_find, judged.found) == ((), frozenset(), frozenset())


def test_a_candidates_segment_is_the_group_that_its_pose_was_found_in() -> None:
    ids = np.full(320, -1)
    ids[:100], ids[100:140] = 0, 1
    view = labelled_capture(FRACTIONS, ids)
    good, bad, nowhere = list(range(80)), [*range(130, 140), *range(90, 100)], list(range(200, 260))
    told = [candidate(view, 1), candidate(view, 0), candidate(view, 0)]
    judged = judge_frame(0, view, observed(view, [good, bad, nowhere], told, of=[1, 0, 2]))
    assert [each.overlap for each in judged.candidates] == [10 / 50, 80 / 100, 0.0]
    assert [each.well_segmented for each in judged.candidates] == [False, True, False]
    assert judged.segments is not None
    assert judged.segments.scores == pytest.approx((0.9, 0.8, 0.7))
    assert judged.explained is not None
    assert len(judged.explained.scores) == 1
    assert judged.ms == {"boundary": 20.0, "segmentation": 60.0}


def test_half_an_overlap_is_a_good_segment() -> None:
    ids = np.full(320, -1)
    ids[:100] = 0
    view = labelled_capture(FRACTIONS, ids)
    for points, good in ((50, True), (49, False)):
        judged = judge_frame(0, view, observed(view, [list(range(points))], [candidate(view, 0)]))
        assert judged.candidates[0].well_segmented == good


def test_a_record_survives_json() -> None:
    view = labelled_capture(FRACTIONS, 0)
    for seen in (
        ObservedCandidates(candidates=[candidate(view, 2)]),
        observed(view, [[0, 1], [5]], [candidate(view, 0)]),
    ):
        judged = judge_frame(3, view, seen)
        assert FrameRecord.from_plain(json.loads(json_text(asdict(judged)))) == judged

"""ScanNet's instance AP against the benchmark's own figures, a naive twin and cases worked by hand."""

import json
import runpy
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.instance import Instance
from perception.metrics import average_precision as module
from perception.metrics.average_precision import (
    ApSummary,
    ClassAp,
    ap_summary,
    average_precision,
    bootstrap_ap,
    precision_recall,
)
from perception.metrics.matching import (
    MATCHED_OVERLAPS,
    OVERLAPS,
    SceneMatches,
    SceneTruth,
    match_scene,
    object_ious,
)

GOLDEN = Path(__file__).parents[2] / "golden"
TWIN = runpy.run_path(str(Path(__file__).parents[2] / "reference" / "average_precision_twin.py"))
PART = 100  # points


def truth(ids: Sequence[int] | np.ndarray, classes: Sequence[int], ignored: Sequence[bool] | None = None) -> SceneTruth:
    return SceneTruth(
        instance_ids=np.asarray(ids, np.int64),
        class_of_instance=np.asarray(classes, np.int64),
        ignored=np.zeros(len(classes), np.bool_) if ignored is None else np.asarray(ignored, np.bool_),
    )


def row_of_parts(parts: int, void: int = 0, ignored: Sequence[bool] | None = None) -> SceneTruth:
    """Part i lies on points 100 i to 100 i + 99; ``void`` points follow."""
    return truth(np.r_[np.repeat(np.arange(parts), PART), np.full(void, -1)], [0] * parts, ignored)


def points(first: int, end: int, score: float = 1.0, label: int = 0) -> Instance:
    return Instance(point_idx=np.arange(first, end), score=score, label=label)


def verdicts(matches: SceneMatches, overlap: float = 0.5) -> list[tuple[float, bool]]:
    mine = matches.overlap_idx == matches.overlaps.index(overlap)
    return sorted(zip(matches.scores[mine].tolist(), matches.correct[mine].tolist(), strict=True))


def random_scene(rng: np.random.Generator, size: int = 60) -> tuple[SceneTruth, list[Instance]]:
    """A few small regions of two classes with void; predictions are noisy or joined regions, tied, overlapping."""
    parts = int(rng.integers(0, 6))
    ids = rng.integers(-1, parts, size) if rng.random() < 0.3 else np.sort(rng.integers(-1, parts, size))
    found = []
    for _ in range(rng.integers(0, 9)):
        mask = np.isin(ids, rng.integers(-1, max(parts, 1), rng.integers(1, 3)))
        mask ^= rng.random(size) < rng.choice([0.0, 0.1, 0.4])
        score, label = float(rng.integers(0, 4)) / 4, int(rng.integers(0, 2))
        found.append(Instance(point_idx=np.flatnonzero(mask), score=score, label=label))
    return truth(ids, rng.integers(0, 2, parts), rng.random(parts) < 0.2), found


def noisy_matches(scenes: int, seed: int = 0) -> list[SceneMatches]:
    """Scenes of 12 parts of which each is found with an IoU and a confidence that go together."""
    rng = np.random.default_rng(seed)
    matches = []
    for _ in range(scenes):
        shares = rng.uniform(0.3, 1.0, 12)
        scores = np.clip(shares + rng.normal(0, 0.2, 12), 0, 1)
        sizes = (shares * 400).astype(int)
        found = [points(400 * i, 400 * i + n, float(s)) for i, (n, s) in enumerate(zip(sizes, scores, strict=True))]
        matches.append(match_scene(truth(np.repeat(np.arange(12), 400), [0] * 12), found))
    return matches


def golden_case(arrays: dict[str, np.ndarray], case: int, scene: int) -> tuple[SceneTruth, list[Instance]]:
    gt, masks, labels, scores = (arrays[f"c{case}_s{scene}_{name}"] for name in ("gt", "mask", "lab", "conf"))
    named = np.unique(gt[(gt >= 1000) & (gt < 3000)])
    ids = np.where(np.isin(gt, named), np.searchsorted(named, gt), -1)
    found = [
        Instance(point_idx=np.flatnonzero(mask), score=float(score), label=int(label))
        for mask, score, label in zip(
            np.unpackbits(masks, axis=1, count=len(gt)) if len(masks) else [], scores, labels, strict=True
        )
    ]
    return truth(ids, named // 1000), found


def test_every_golden_case_agrees_with_the_benchmarks_script() -> None:
    golden = json.loads((GOLDEN / "scannet_ap_golden.json").read_text())
    with np.load(GOLDEN / "scannet_ap_golden.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    overlaps, nothing = golden["thresholds"], np.full(len(golden["thresholds"]), np.nan)
    for c, case in enumerate(golden["cases"]):
        matches = [
            match_scene(*golden_case(arrays, c, s), overlaps=overlaps, min_region=golden["min_region"])
            for s in range(case["scenes"])
        ]
        values = average_precision(matches, overlaps)
        for k, label in enumerate(golden["classes"]):
            expected = [case["ap"][str(overlap)][k] for overlap in overlaps]
            np.testing.assert_allclose(values.get(label, nothing), expected, rtol=0, atol=1e-12, err_msg=f"case {c}")
    assert len(golden["cases"]) == 60


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 5, 12]))
def test_agrees_with_the_naive_twin(seed: int, min_region: int) -> None:
    rng = np.random.default_rng(seed)
    scenes = [random_scene(rng) for _ in range(rng.integers(1, 4))]
    overlaps = (0.0, 0.1, 0.25, 0.5, 0.75)
    values = average_precision([match_scene(*scene, overlaps, min_region) for scene in scenes], overlaps)
    plain = [
        (t.instance_ids, t.class_of_instance, t.ignored, [(set(i.point_idx.tolist()), i.score, i.label) for i in found])
        for t, found in scenes
    ]
    for label in (0, 1):
        expected = [TWIN["average_precision"](plain, overlap, label, min_region) for overlap in overlaps]
        np.testing.assert_allclose(values.get(label, np.full(5, np.nan)), expected, rtol=0, atol=1e-12)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_object_ious_agree_with_the_naive_twin(seed: int) -> None:
    scene, found = random_scene(np.random.default_rng(seed))
    for p, best in enumerate(object_ious(scene, found)):
        region = set(np.flatnonzero(scene.instance_ids == p).tolist())
        mine = [set(i.point_idx.tolist()) for i in found if i.label == scene.class_of_instance[p]]
        expected = max((TWIN["iou"](region, other) for other in mine), default=0.0) if region else np.nan
        np.testing.assert_allclose(best, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("scores", [[1.0, 1.0, 1.0], [0.2, 0.9, 0.5]])
def test_the_truth_scores_exactly_one(scores: list[float]) -> None:
    found = [points(100 * i, 100 * i + 100, score) for i, score in enumerate(scores)]
    matches = [match_scene(row_of_parts(3, void=50), found)] * 2
    perfect = {"ap": 1.0, "ap50": 1.0, "ap75": 1.0, "ap25": 1.0}
    assert ap_summary(matches) == ApSummary(**perfect, per_class={0: ClassAp(**perfect)})
    assert object_ious(row_of_parts(3), found).tolist() == [1.0, 1.0, 1.0]


def test_nothing_scores_zero() -> None:
    matches = [match_scene(row_of_parts(3), [])]
    assert average_precision(matches)[0].tolist() == [0.0] * 9
    assert ap_summary(matches).ap == 0.0
    assert object_ious(row_of_parts(3), []).tolist() == [0.0, 0.0, 0.0]


def test_one_right_and_one_wrong_at_one_score_give_three_eighths() -> None:
    matches = [match_scene(row_of_parts(2), [points(0, 100, 0.7), points(0, 200, 0.7)], (0.5,))]
    assert verdicts(matches[0]) == [(0.7, False), (0.7, True)]  # (0, 200) has an IoU of exactly .5 with both
    assert average_precision(matches, (0.5,))[0].tolist() == [0.375]
    precision, recall, scores = precision_recall(matches, 0.5)
    assert precision.tolist() == [0.5, 1.0]
    assert recall.tolist() == [0.5, 0.0]
    assert scores.tolist() == [0.7, np.inf]


def test_the_curve_is_not_interpolated() -> None:
    # right .9, wrong .8, right .7 of two parts: points (1, 0), (1, .5), (.5, .5), (2/3, 1)
    found = [points(0, 100, 0.9), points(50, 150, 0.8), points(100, 200, 0.7)]
    matches = [match_scene(row_of_parts(2), found)]
    curve = precision_recall(matches, 0.5)
    assert curve.recall.tolist() == [1.0, 0.5, 0.5, 0.0]
    assert curve.precision.tolist() == pytest.approx([2 / 3, 0.5, 1.0, 1.0])
    assert average_precision(matches, [0.5])[0][0] == pytest.approx(0.5 * 1.0 + 0.5 * (0.5 + 2 / 3) / 2)


def test_the_curves_area_is_the_average_precision() -> None:
    matches = noisy_matches(5)
    curve = precision_recall(matches, 0.6)
    area = -np.trapezoid(curve.precision, curve.recall)
    assert average_precision(matches, [0.6])[0][0] == pytest.approx(area, abs=1e-12)
    assert 0.1 < area < 0.9


def test_an_iou_equal_to_the_overlap_is_no_match() -> None:
    matches = match_scene(row_of_parts(1, void=1000), [points(0, 200)], (0.45, 0.5))
    assert verdicts(matches, 0.45) == [(1.0, True)]
    assert verdicts(matches, 0.5) == [(1.0, False)]  # half of it on void: exactly .5 is not enough to be ignored


def test_of_duplicates_the_most_confident_is_right_and_each_other_one_wrong() -> None:
    found = [points(0, 100, 0.3), points(0, 100, 0.9), points(0, 110, 0.5)]
    assert verdicts(match_scene(row_of_parts(2), found)) == [(0.3, False), (0.5, False), (0.9, True)]


def test_a_duplicate_may_be_the_first_match_of_a_later_instance() -> None:
    # The second prediction holds two parts, IoU .5 with each: duplicate of part 0 and match of part 1.
    found = [points(0, 100, 0.9), points(0, 200, 0.4)]
    assert verdicts(match_scene(row_of_parts(2), found), 0.25) == [(0.4, False), (0.4, True), (0.9, True)]


def test_the_first_of_two_predictions_is_used_up_by_the_first_instance() -> None:
    # Both hold both parts: part 0 takes the first and counts the second as duplicate, part 1 is left the second.
    found = [points(0, 200, 0.9), points(0, 200, 0.4)]
    assert verdicts(match_scene(row_of_parts(2), found), 0.25) == [(0.4, False), (0.4, True), (0.9, True)]
    assert verdicts(match_scene(row_of_parts(2), found[::-1]), 0.25) == [(0.4, False), (0.9, True), (0.9, True)]


def test_predictions_mostly_on_void_are_ignored() -> None:
    matches = match_scene(row_of_parts(1, void=300), [points(60, 160), points(30, 130), points(100, 250)])
    assert verdicts(matches, 0.5) == [(1.0, True)]  # 60 and 100 % void are ignored, 30 % is part 0 with IoU .54
    assert verdicts(matches, 0.6) == [(1.0, False), (1.0, False)]  # 60 % is not more than 60 %


def test_predictions_on_ignored_or_small_instances_are_neither_right_nor_wrong() -> None:
    found = [points(0, 100, 0.9), points(100, 200, 0.8), points(200, 400, 0.7)]
    assert verdicts(match_scene(row_of_parts(4), found)) == [(0.7, False), (0.8, True), (0.9, True)]
    ignoring = match_scene(row_of_parts(4, ignored=[False, True, True, True]), found)
    assert verdicts(ignoring) == [(0.9, True)]
    assert ignoring.truth_counts == {0: 1}
    scene = truth(np.r_[np.zeros(100), np.ones(99), np.full(50, -1)], [0, 0])
    small = match_scene(scene, [found[0], points(99, 199)])
    assert verdicts(small) == [(0.9, True)]
    assert small.truth_counts == {0: 1}


def test_a_band_of_visible_fractions_is_scored_alone() -> None:
    visible = np.array([0.9, 0.3, 0.4])
    found = [points(0, 100, 0.9), points(100, 200, 0.8)]
    for low, high, expected in ((0.5, 1.0, 1.0), (0.0, 0.5, 0.5)):
        scene = row_of_parts(3, ignored=((visible < low) | (visible >= high)).tolist())
        assert average_precision([match_scene(scene, found)])[0].tolist() == [expected] * 9


def test_instances_of_another_class_excuse_nothing_and_match_nothing() -> None:
    scene = truth(np.repeat([0, 1], 100), [0, 1], [False, True])
    matches = match_scene(scene, [points(0, 100, 0.9), points(100, 200, 0.8), points(0, 100, 0.7, label=1)])
    assert verdicts(matches) == [(0.7, False), (0.8, False), (0.9, True)]
    assert object_ious(scene, [points(0, 200)]).tolist() == [0.5, 0.0]


def test_predictions_under_min_region_do_not_exist() -> None:
    found = [points(0, 99, 0.9), points(100, 200, 0.8)]
    assert verdicts(match_scene(row_of_parts(2), found)) == [(0.8, True)]
    assert verdicts(match_scene(row_of_parts(2), found, min_region=99)) == [(0.8, True), (0.9, True)]


def test_when_every_prediction_is_ignored_the_score_is_zero() -> None:
    matches = [match_scene(row_of_parts(1, void=100), [points(100, 200)])]
    assert len(matches[0].scores) == 0
    assert average_precision(matches)[0].tolist() == [0.0] * 9


def test_without_ground_truth_the_class_is_nan_and_left_out_of_the_mean() -> None:
    alone = [match_scene(row_of_parts(1, ignored=[True]), [points(0, 50), points(0, 100, label=3)])]
    assert np.isnan(average_precision(alone)[3]).all()
    assert np.isnan(ap_summary(alone).ap)
    assert np.isnan(precision_recall(alone, 0.5, label=3).recall).all()
    assert np.isnan(bootstrap_ap(alone, np.random.default_rng(0)).ap).all()
    beside = [*alone, match_scene(row_of_parts(1), [points(0, 100)])]
    assert ap_summary(beside).ap == 1.0
    assert np.isnan(ap_summary(beside).per_class[3].ap50)


def test_empty_scenes_and_no_scenes() -> None:
    empty = match_scene(truth([], []), [])
    assert average_precision([empty]) == {}
    assert average_precision([]) == {}
    assert np.isnan(ap_summary([]).ap)
    found = match_scene(row_of_parts(1), [points(0, 100)])
    assert ap_summary([empty, found]) == ap_summary([found])
    assert match_scene(row_of_parts(1), [Instance(point_idx=np.empty(0, np.int64), score=1.0)]).scores.size == 0
    assert np.isnan(object_ious(truth([1, 1], [0, 0]), [])).tolist() == [True, False]


def test_scenes_are_pooled_and_not_averaged() -> None:
    good = match_scene(row_of_parts(3), [points(100 * i, 100 * i + 100) for i in range(3)])
    poor = match_scene(row_of_parts(1), [])
    assert ap_summary([good, poor]).ap50 == pytest.approx(0.75)


def test_the_summary_averages_classes_and_the_nine_overlaps() -> None:
    scene = truth(np.repeat([0, 1], 1000), [0, 5])
    summary = ap_summary([match_scene(scene, [points(0, 720), points(1000, 1970, label=5)])])
    assert tuple(np.round(np.arange(0.5, 0.95, 0.05), 2).tolist()) == OVERLAPS
    assert summary.per_class[0] == ClassAp(ap=pytest.approx(5 / 9), ap50=1.0, ap75=0.0, ap25=1.0)
    assert summary.per_class[5] == ClassAp(ap=1.0, ap50=1.0, ap75=1.0, ap25=1.0)
    assert (summary.ap, summary.ap50, summary.ap75) == (pytest.approx(7 / 9), 1.0, 0.5)


def test_bootstrap_intervals_hold_the_estimate_and_follow_from_the_rng() -> None:
    matches = noisy_matches(25)
    summary = ap_summary(matches)
    intervals = bootstrap_ap(matches, np.random.default_rng(1), 300)
    assert intervals == bootstrap_ap(matches, np.random.default_rng(1), 300)
    assert intervals != bootstrap_ap(matches, np.random.default_rng(2), 300)
    for name in ("ap", "ap50", "ap75"):
        low, high = getattr(intervals, name)
        assert low < getattr(summary, name) < high < low + 0.2, name
    assert intervals.ap25 == (1.0, 1.0)


def test_a_bootstrap_resample_is_the_average_precision_of_the_scenes_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHUNK", 100)  # several chunks
    matches = noisy_matches(4, seed=3)
    draws = np.random.default_rng(5).multinomial(4, [0.25] * 4, size=60)
    pools = [[matches[s] for s in np.repeat(np.arange(4), draw)] for draw in draws]
    expected = np.quantile([ap_summary(pool).ap for pool in pools], [0.025, 0.975])
    assert bootstrap_ap(matches, np.random.default_rng(5), 60).ap == pytest.approx(expected.tolist(), abs=1e-12)


def test_one_scene_has_no_spread() -> None:
    matches = noisy_matches(1)
    summary = ap_summary(matches)
    assert bootstrap_ap(matches, np.random.default_rng(0), 10).ap == (summary.ap, summary.ap)


def test_mistakes_are_named() -> None:
    scene = row_of_parts(1)
    with pytest.raises(ValueError, match=r"instance_ids must be \(N,\), got \(2, 3\)"):
        truth(np.zeros((2, 3)), [0])
    with pytest.raises(ValueError, match=r"class_of_instance must be \(N,\), got \(1, 1\)"):
        truth([0], np.zeros((1, 1)), [False])
    with pytest.raises(ValueError, match=r"ignored must be \(1,\), got \(2,\)"):
        truth([0], [0], [False, True])
    with pytest.raises(ValueError, match="ignored must be bool, got int64"):
        SceneTruth(instance_ids=np.zeros(1, int), class_of_instance=np.zeros(1, int), ignored=np.zeros(1, int))
    with pytest.raises(ValueError, match="instance_ids must be -1 to 0 for 1 instances, got -1 to 1"):
        truth([-1, 1], [0])
    with pytest.raises(ValueError, match="got -2 to -1"):
        truth([-2], [0])
    with pytest.raises(ValueError, match="min_region must be at least 1 point, got 0"):
        match_scene(scene, [], min_region=0)
    with pytest.raises(ValueError, match=r"overlaps must be at least 0 and less than 1, got \(0.5, 1.0\)"):
        match_scene(scene, [], (0.5, 1.0))
    for wrong in ([5, 100], [-1, 5], [5, 5], [6, 5]):
        with pytest.raises(ValueError, match="point_idx of instance 1 must ascend within 0 to 99, without repeats"):
            match_scene(scene, [points(0, 10), Instance(point_idx=np.array(wrong), score=1.0)])
    with pytest.raises(ValueError, match="point_idx of instance 0"):
        object_ious(scene, [points(0, 101)])


def test_mistakes_of_pooling_are_named() -> None:
    matches = [match_scene(row_of_parts(1), []), match_scene(row_of_parts(1), [], (0.5,))]
    with pytest.raises(ValueError, match=r"scene 1 was not matched at overlap 0.25, but at \(0.5,\)"):
        ap_summary(matches)
    with pytest.raises(ValueError, match=r"scene 0 was not matched at overlap 0.4"):
        precision_recall(matches, 0.4)
    with pytest.raises(ValueError, match="at least 1 scene and 1 resample are needed, got 0 and 1000"):
        bootstrap_ap([], np.random.default_rng(0))
    with pytest.raises(ValueError, match="got 2 and 0"):
        bootstrap_ap(matches, np.random.default_rng(0), 0)
    wrongs = {
        "scores": np.zeros(1),
        "labels": np.zeros((1, 1), int),
        "overlap_idx": np.zeros(2, int),
        "correct": np.ones(1),
    }
    for name, wrong in wrongs.items():
        values = {
            "labels": np.zeros(0, np.int64),
            "overlap_idx": np.zeros(0, np.int64),
            "scores": np.zeros(0),
            "correct": np.zeros(0, np.bool_),
            name: wrong,
        }
        with pytest.raises(ValueError, match=name + r" must be"):
            SceneMatches(overlaps=MATCHED_OVERLAPS, truth_counts={}, **values)


def test_a_percentile_interval_is_over_the_values_that_are_not_nan() -> None:
    assert module.percentile_interval(np.append(np.nan, np.arange(101.0))) == pytest.approx((2.5, 97.5))
    assert module.percentile_interval(np.array([np.nan, 0.3])) == (0.3, 0.3)
    assert np.isnan(module.percentile_interval(np.array([np.nan]))).all()

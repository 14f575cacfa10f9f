"""Numbers of an evaluation of poses, computed by hand on scenes of four parts."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binpick_env.evaluation.pose import table as table_module
from binpick_env.evaluation.pose.ablation import PoseRow, pose_rows, tabulate_poses
from binpick_env.evaluation.pose.ablation_table import pose_ablation_table
from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig
from binpick_env.evaluation.pose.method import PoseMethodConfig
from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.pose.scene_score import PoseSceneScore, worst_first
from binpick_env.evaluation.pose.statistics import median, pose_counts, pose_intervals, reliability, resampled_quotients
from binpick_env.evaluation.pose.summary import PoseSummary, summarise_poses
from binpick_env.evaluation.pose.table import pose_table, quantiles, table_three
from binpick_env.evaluation.segmentation.summary import BANDS
from binpick_env.scenes.synthesis import SceneConfig
from perception.metrics.intervals import wilson_interval
from perception.pose.model.viewpoints import VIEW_COUNTS
from tests.binpick_env.evaluation.pose.pose_records import EACH, bracket, estimates, moved, record

CONFIG = PoseEvaluationConfig(scenes=SceneConfig(part="bracket", seed=31))
TRUE = record().T_cam_parts


def score_of(scene: PoseRecord, index: int = 0) -> PoseSceneScore:
    return PoseSceneScore.from_record(scene, index, bracket())


def summary_of(*scenes: PoseRecord, config: PoseEvaluationConfig = CONFIG) -> PoseSummary:
    scores = [score_of(scene, k) for k, scene in enumerate(scenes)]
    return summarise_poses(config, scores, np.random.default_rng(0), resamples=200)


# --- one scene -------------------------------------------------------------------------------------------------------


def test_the_truth_scores_one_and_nothing_scores_zero() -> None:
    whole = summary_of(record(), record())
    assert (whole.recognition_rate, whole.recall, whole.precision) == (1.0, 1.0, 1.0)
    assert (whole.trials, whole.parts_to_find, whole.verified) == (6, 4, 8)
    assert (whole.pose_ap, whole.unverified_pose_ap, whole.ap, whole.ap75) == (1.0, 1.0, 1.0, 1.0)
    assert whole.translation_mm["p95"] == pytest.approx(0.0, abs=1e-9)
    assert whole.rotation_deg["p95"] == pytest.approx(0.0, abs=1e-5)
    nothing = summary_of(record(**estimates(np.zeros((0, 4, 4)), [], [])))
    assert (nothing.recognition_rate, nothing.recall, nothing.pose_ap) == (0.0, 0.0, 0.0)
    assert nothing.trials == 3
    assert nothing.intervals["precision"] == (0.0, 1.0)
    for value in (nothing.precision, nothing.translation_mm["median"], nothing.brier, nothing.calibration_error):
        assert np.isnan(value)


def test_an_empty_bin_counts_for_nothing() -> None:
    none = {"labels": np.zeros(0, np.int64), "instance_ids": np.zeros(0, np.int64), "confidences": np.zeros(0)}
    none |= {"pixels": np.zeros((0, 2), np.int64), "trials": np.zeros(0, np.int64), "visible_fractions": np.zeros(0)}
    none |= {"explained": np.zeros(0, np.int64), "explained_confidences": np.zeros(0)}
    bare = record(**none, **estimates(np.zeros((0, 4, 4)), [], []), T_cam_parts=np.zeros((0, 4, 4)))
    both, alone = summary_of(bare, record()), summary_of(record())
    for name in ("recognition_rate", "trials", "recall", "precision", "pose_ap", "ap", "ms_per_group"):
        assert getattr(both, name) == getattr(alone, name)
    assert "–" in pose_table(summary_of(bare))


@pytest.mark.parametrize(
    ("share", "degrees", "right"), [(0.099, 0.0, True), (0.101, 0.0, False), (0.0, 4.9, True), (0.0, 5.1, False)]
)
def test_a_correct_pose_is_within_a_tenth_of_the_diameter_and_five_degrees(
    share: float, degrees: float, right: bool
) -> None:
    poses = TRUE.copy()
    poses[0] = moved(TRUE[0], share, degrees)
    score = score_of(record(poses=poses))
    assert score.trials.recognised.tolist() == [right, True, True]
    assert score.verified.correct.tolist() == [right, True, True, True]
    assert score.correct.tolist() == [right, True, True, True]
    assert score.trials.translations[0] == pytest.approx(share * bracket().d_max)
    assert np.rad2deg(score.trials.rotations[0]) == pytest.approx(degrees, abs=1e-5)


def test_a_trial_is_about_the_part_that_owns_most_of_the_group() -> None:
    labels = record().labels.copy()
    labels[: EACH - 20] = 1  # group 1 has 100 points of part 0 and 120 of part 1; group 0 the 20 that are left
    ids = record().instance_ids.copy()
    ids[2 * EACH : 3 * EACH] = -1  # group 2 lies on the container
    scene = record(labels=labels, instance_ids=ids)
    owners, purities = scene.owners()
    assert owners.tolist() == [0, 1, -1, 3]
    assert purities == pytest.approx([1.0, 120 / 220, 0.0, 1.0])
    assert scene.sizes().tolist() == [20, 220, 120, 120]
    trials = score_of(scene).trials
    assert trials.recognised.tolist() == [True, True, False]  # the pose of group 2 fits a part, but which was meant?
    assert np.isnan(trials.translations[2])
    assert trials.purities == pytest.approx(purities[:3])
    swapped = record(labels=labels, poses=TRUE[[1, 0, 2, 3]])
    assert score_of(swapped).trials.recognised.tolist() == [False, False, True]


def test_a_group_without_a_pose_is_a_trial_that_failed_and_verification_removes_none() -> None:
    score = score_of(record(**estimates(TRUE[1:], [0.8, 0.1, 0.6], [1, 2, 3], [True, False, True])))
    assert score.trials.recognised.tolist() == [False, True, True]
    assert len(score.verified.correct) == 2


def test_only_one_pose_of_a_part_is_correct() -> None:
    poses = np.stack([moved(TRUE[0], 0.05), TRUE[0], TRUE[1]])
    score = score_of(record(**estimates(poses, [0.9, 0.8, 0.7], [0, 1, 2])))
    assert score.verified.correct.tolist() == [True, False, True]
    assert score.verified.matched_part.tolist() == [0, 0, 1]
    assert score.correct.all()
    assert summary_of(record(**estimates(poses, [0.9, 0.8, 0.7], [0, 1, 2]))).precision == pytest.approx(2 / 3)


def test_occluded_parts_count_for_precision_and_not_for_recall() -> None:
    hidden = summary_of(record(**estimates(TRUE[[1, 2, 3]], [0.9, 0.8, 0.7], [1, 2, 3])))
    assert (hidden.precision, hidden.recall, hidden.parts_to_find) == (1.0, 0.5, 2)
    bands = {(band.low, band.parts, band.found) for band in hidden.by_visible_fraction}
    assert bands == {(0.1, 1, 1), (0.3, 1, 1), (0.5, 1, 1), (0.7, 0, 0), (0.9, 1, 0)}
    assert [band.high for band in hidden.by_visible_fraction] == [high for _, high in BANDS[:-1]] + [1.0]


def test_numbers_without_verification_count_all_poses() -> None:
    poses = np.concatenate([TRUE, moved(TRUE[0], 0.5)[None]])
    kept = [True, False, True, True, False]
    groups = summary_of(record(**estimates(poses, [0.9, 0.3, 0.8, 0.7, 0.2], [0, 1, 2, 3, 0], kept)))
    assert (groups.recall, groups.precision, groups.verified) == (0.5, 1.0, 3)
    assert groups.unverified == {"recall": 1.0, "precision": 0.8, "poses": 5}
    assert groups.pose_ap < groups.unverified_pose_ap


def test_without_segments_a_trial_takes_the_nearest_pose() -> None:
    poses = np.stack([moved(TRUE[2], 0.2), TRUE[2], TRUE[1]])
    ms = record().ms | {"trials": np.nan}
    scene = record(**estimates(poses, [0.9, 0.8, 0.7], [-1, -1, -1]), whole_scene=True, ms=ms)
    score = score_of(scene)
    assert score.trials.recognised.tolist() == [False, True, True]
    assert score.trials.translations[2] == pytest.approx(0.0, abs=1e-12)
    assert len(score.segmentation.scores) == 0
    method = PoseMethodConfig(perception="whole_scene")
    summary = summary_of(scene, config=replace(CONFIG, method=method))
    assert np.isnan([summary.ms_trials, summary.ms_per_group]).all()
    assert (summary.ap, summary.explained["ap"]) == (0.0, 1.0)
    assert "a group" not in pose_table(summary)
    (row,) = [line for line in table_three(summary).splitlines() if line.startswith("PPF-MEAM")]
    assert row.split()[2] == "40"


def test_the_worst_scenes_come_first() -> None:
    empty = record(visible_fractions=np.full(4, 0.2))
    false = record(poses=np.concatenate([TRUE[:3], moved(TRUE[3], 0.5)[None]]))
    lost = record(**estimates(TRUE[:1], [0.9], [0]))
    order = worst_first([score_of(scene, k) for k, scene in enumerate((empty, record(), false, lost))])
    assert [score.index for score in order] == [3, 2, 1, 0]


# --- many scenes -----------------------------------------------------------------------------------------------------


def test_reliability_is_counted_by_tenths_of_the_score() -> None:
    poses = np.stack([TRUE[0], moved(TRUE[1], 0.5), TRUE[2], TRUE[3]])
    scores = [score_of(record(poses=poses, scores=np.array([1.0, 0.95, 0.1, 0.0])))] * 2
    bins = reliability(scores)
    assert [each.poses for each in bins] == [2, 2, 0, 0, 0, 0, 0, 0, 0, 4]
    assert [each.right for each in bins] == [2, 2, 0, 0, 0, 0, 0, 0, 0, 2]
    assert (bins[9].share, bins[9].mean_score) == (0.5, pytest.approx(0.975))
    assert bins[9].interval == wilson_interval(2, 4)
    assert np.isnan(bins[5].share)
    summary = summarise_poses(CONFIG, scores, np.random.default_rng(0), 10)
    assert summary.calibration_error == pytest.approx((2 * 1.0 + 2 * 0.9 + 4 * 0.475) / 8)
    assert summary.brier == pytest.approx((0.0 + 0.95**2 + 0.9**2 + 1.0) / 4)


def test_intervals_by_hand() -> None:
    half = record(**estimates(TRUE[:1], [0.9], [0]))
    counts = pose_counts([score_of(scene) for scene in (record(), half)])
    np.testing.assert_array_equal(counts, [[3, 3, 2, 2, 4, 4], [1, 3, 1, 2, 1, 1]])
    weights = np.array([[2.0, 0.0], [1.0, 1.0], [0.0, 2.0]])
    quotients = resampled_quotients(counts, weights)
    np.testing.assert_allclose(quotients, [[1.0, 1.0, 1.0], [4 / 6, 0.75, 1.0], [1 / 3, 0.5, 1.0]])
    intervals = pose_intervals(counts, weights)
    assert intervals["recognition_rate"] == wilson_interval(4, 6)
    assert intervals["precision"] == wilson_interval(5, 5)
    assert intervals["recall"] == pytest.approx(tuple(np.quantile([1.0, 0.75, 0.5], (0.025, 0.975))))
    assert np.isnan(resampled_quotients(np.zeros((1, 6)), np.ones((1, 1)))).all()


def test_what_the_poses_explain_is_compared_with_what_was_segmented() -> None:
    halves = record().labels.copy()
    halves[:EACH] = -1
    halves[: EACH // 2] = 0  # half of part 0 is left: an IoU of 0.5 is not more than 0.5
    summary = summary_of(record(labels=halves), record(labels=halves))
    assert summary.explained == {"ap": 1.0, "ap50": 1.0, "ap75": 1.0}
    assert summary.ap50 == summary.ap == pytest.approx(1 - summary.explained_gain["ap"][0])
    value, low, high = summary.explained_gain["ap75"]
    assert 0.1 < value < 0.6
    assert (low, high) == pytest.approx((value, value))  # both scenes are alike
    assert f"AP 100.0 ({100 * value:+.1f}, 95 %: {100 * value:+.1f}" in pose_table(summary)


def test_times_are_medians_over_scenes_without_nan() -> None:
    slow = record(ms=record().ms | {"pose": 80.0, "trials": np.nan})
    summary = summary_of(record(), slow)
    assert (summary.ms_segmentation, summary.ms_pose, summary.ms_trials) == (5.0, 60.0, 30.0)
    assert summary.ms_per_group == 15.0
    assert np.isnan(median([np.nan]))


def test_a_summary_needs_a_scene() -> None:
    with pytest.raises(ValueError, match="there is nothing to sum up: no scene was evaluated"):
        summary_of()


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilsons_interval_is_newcombes(successes: int, n: int, low: float, high: float) -> None:
    """Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in Medicine 17 (1998)."""
    assert wilson_interval(successes, n) == pytest.approx((low, high), abs=6e-5)
    assert wilson_interval(n - successes, n) == pytest.approx((1 - high, 1 - low), abs=6e-5)
    assert wilson_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match=r"successes must be in 0\.\.n, got 3 of 2"):
        wilson_interval(3, 2)


# --- text ------------------------------------------------------------------------------------------------------------


def test_the_table_says_what_was_counted() -> None:
    text = pose_table(summary_of(record(), record(**estimates(TRUE[:1], [0.9], [0]))))
    assert text.startswith("bracket · true segments · sensor good · 2 scenes · seed 31")
    rows = {line.split("  ")[0]: line.split() for line in text.splitlines()}
    assert rows["recognition rate"][2:] == ["66.7", "30.0", "to", "90.3", "6", "trials"]
    bands = [line.split() for line in text.splitlines() if line.startswith("0.9 to 1.0")]
    assert bands[0][3:] == ["2", "2", "100.0", "34.2", "to", "100.0"]  # of parts, then of scores
    assert bands[1][3:] == ["2", "2", "90.0", "100.0", "34.2", "to", "100.0"]
    assert "scenes were evaluated by commit abc" in text
    assert "another machine" in text.replace("\n", " ")
    assert max(map(len, text.splitlines()[:2])) <= 78


def test_the_papers_table_is_beside_ours() -> None:
    lines = table_three(summary_of(record())).splitlines()
    rows = {line.split("  ")[0]: line.split()[-4:] for line in lines[:5]}
    assert rows["Recognition rate [%]"] == ["100.0", "98.33", "98.33", "93.93"]
    assert rows["Segmentation of a scene [ms]"] == ["–", "2087", "1892", "1528"]  # true segments cost nothing
    assert rows["PPF-MEAM [ms]"] == ["30", "1224", "1085", "641"]
    assert rows["Total [ms]"] == ["–", "3311", "2977", "2169"]
    assert "3 trials in 1 scene of seed 31" in " ".join(lines)
    assert "real scenes of other parts, on another machine" in " ".join(lines)


def test_the_papers_total_is_from_a_frame_to_the_poses() -> None:
    summary = summary_of(record())  # ms: boundary 1, surface 2, segmentation 3, poses 40, those of the trials 30
    for perception, expected in (("learned", ["6", "30", "36"]), ("whole_scene", ["–", "40", "46"])):
        lines = table_three(replace(summary, perception=perception)).splitlines()
        rows = {line.split("  ")[0]: line.split()[-4] for line in lines[:5]}
        assert [rows[f"{name} [ms]"] for name in ("Segmentation of a scene", "PPF-MEAM", "Total")] == expected


def test_quantiles_are_a_dash_without_values() -> None:
    assert quantiles({"median": 1.5, "p90": 1.8, "p95": 2.0}, "mm") == "median 1.50, 95 % under 2.00 mm"
    assert quantiles(dict.fromkeys(("median", "p90", "p95"), np.nan), "mm") == "–"


def test_causes_are_counted_over_frames_and_survive_a_file(tmp_path: Path) -> None:
    record(causes=("few_pixels", "underexposed")).save(tmp_path / "a.npz")
    assert PoseRecord.load(tmp_path / "a.npz").causes == ("few_pixels", "underexposed")
    summary = summary_of(PoseRecord.load(tmp_path / "a.npz"), record(causes=("underexposed",)), record())
    assert summary.frame_causes == {"underexposed": 2, "few_pixels": 1}
    assert "causes        underexposed in 2, few_pixels in 1 of 3 frames" in pose_table(summary)
    assert "causes  " not in pose_table(summary_of(record()))


def test_unknown_commits_are_named_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_module, "git_commit", lambda: "")
    text = " ".join(pose_table(summary_of(record())).split())
    assert "scenes were evaluated by commit abc, this is unknown: --fresh evaluates them again" in text
    assert "evaluated by commit" not in pose_table(replace(summary_of(record()), git_commits=[""]))
    monkeypatch.setattr(table_module, "git_commit", lambda: "def")
    text = pose_table(replace(summary_of(record()), git_commits=["", "abc"]))
    assert "evaluated by commit unknown, abc, this is def" in text


# --- ablation --------------------------------------------------------------------------------------------------------


def tabulated(*rows: tuple[Sequence[PoseRecord], dict[str, Any]]) -> Any:
    method = PoseMethodConfig()
    given = []
    for k, (scenes, changes) in enumerate(rows):
        scores = [score_of(scene, index) for index, scene in enumerate(scenes)]
        given.append((PoseRow(key=str(k), name=f"row {k}", method=method, **changes), scores))
    return tabulate_poses(given, CONFIG.scenes, np.random.default_rng(0), 200)


def test_rows_are_compared_on_the_same_scenes() -> None:
    lost = record(**estimates(TRUE[:1], [0.9], [0]))
    mixed = [record(), lost, record(), lost]
    table = tabulated((mixed, {}), (mixed, {}), ([record()] * 4, {}))
    full, same, better = table.rows
    assert full.against_full is None
    assert set(same.against_full.values()) == {(0.0, 0.0, 0.0)}
    value, low, high = better.against_full["recall"]
    assert value == pytest.approx(0.25)
    assert 0.0 <= low < value < high <= 0.5
    assert better.recognition_rate == 1.0
    assert better.intervals["recognition_rate"] == wilson_interval(12, 12)
    text = pose_ablation_table(table)
    assert "bracket · sensor good · 4 scenes · seed 31 · 12 trials · threads: 1" in text
    assert [line.startswith("row 2") for line in text.splitlines()].count(True) == 2


def test_a_row_without_verification_counts_every_pose() -> None:
    poses = np.concatenate([TRUE[:3], moved(TRUE[3], 0.5)[None]])
    scene = [record(**estimates(poses, [0.9, 0.8, 0.2, 0.1], [0, 1, 2, 3], [True, True, False, False]))]
    strict, loose = tabulated((scene, {}), (scene, {"verified": False})).rows
    assert (strict.precision, strict.delivered) == (1.0, 2)
    assert (loose.precision, loose.delivered) == (0.75, 4)
    assert loose.recognition_rate == strict.recognition_rate == 1.0


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(ValueError, match="there is nothing to tabulate: no row, or no scene"):
        tabulate_poses([], CONFIG.scenes, np.random.default_rng(0))
    with pytest.raises(ValueError, match="all rows must be of the same scenes, 'row 1' is of others"):
        tabulated(([record(), record()], {}), ([record()], {}))


def test_each_row_leaves_one_thing_out() -> None:
    rows = {row.key + str(row.verified): row for row in pose_rows()}
    full = rows["fullTrue"].method
    assert rows["fullFalse"].method == full
    assert rows["pairsTrue"].method.estimator.pairs.same_view is False
    assert rows["spreadTrue"].method.estimator.pairs.angle_noise == 0.0
    assert [rows[f"signs-{kind}True"].method.estimator.pairs.signs for kind in ("no_flip", "raw")] == ["no_flip", "raw"]
    assert rows["whole-sceneTrue"].method == replace(full, perception="whole_scene")
    views = {row.method.estimator.edges.views for row in rows.values()}
    assert views == set(VIEW_COUNTS)
    methods = [row.method for row in rows.values() if row.verified]
    assert len(set(methods)) == len(methods) == len(rows) - 1

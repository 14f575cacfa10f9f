import json
from dataclasses import replace

import numpy as np
import pytest

from binpick_env.jobs.text_tables import columns
from perception.metrics.intervals import wilson_interval
from perception.runtime.files import json_text
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.frame_record import CandidateRecord, FrameRecord
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import Summary, summarise
from policies.evaluation.tables import result_table
from policies.grasping.outcomes import Abstention, DoubleCheck, GraspOutcome, PickResult, PushOutcome
from tests.policies.fake_cell import abstain, attempt, bin_result, pushed

CONFIG = EvaluationConfig()
DELIVERED, MISSED = GraspOutcome.DELIVERED, GraspOutcome.MISSED
RATES = {"gsr", "dr", "mpph", "ap", "ap50", "ap75", "candidate_pose_accuracy", "intervals"}
FRAMES = {"candidate_precision", "candidate_recall", "candidates", "pose_error", "frames", "perception_ms"}
FAILURES = {"failure_attribution", "blame"}  # the second is the previous name, written for one version
COUNTS = {"attempts", "successes", "parts_total", "delivered", "lost", "abstentions", "termination", "outcomes"}
CONTRACT = RATES | COUNTS | FRAMES | FAILURES | {"time", "clutter", "camera_backend", "versions"}


def record(index: int, *picks: PickResult, parts: int = 10, lost: int = 0) -> BinRecord:
    facts = {"config_hash": CONFIG.digest(), "index": index, "wall": 12.0, "settle": 2.0, "render": 3.0}
    return BinRecord.from_result(bin_result(*picks, parts=parts, lost=lost), [""] * len(picks), **facts)


@pytest.fixture
def records() -> list[BinRecord]:
    first = record(0, attempt(DELIVERED), attempt(DELIVERED), abstain(), attempt(MISSED, t_motion=2.0))
    return [first, record(1, attempt(DELIVERED), abstain(Abstention.IK_INFEASIBLE), parts=30)]


def compared(*right: bool, overlap: float | None = None) -> FrameRecord:
    """Return a frame with one candidate per part."""
    candidates = [
        CandidateRecord(part=k, score=0.9, right=good, found=k if good else -1, overlap=overlap)
        for k, good in enumerate(right)
    ]
    return FrameRecord(frame_id=-1, visible_fractions=(1.0,) * len(right), candidates=tuple(candidates))


def summary_of(records: list[BinRecord]) -> Summary:
    return summarise(records, CONFIG, np.random.default_rng(0))


def test_rates_are_pooled_over_the_bins(records: list[BinRecord]) -> None:
    summary = summary_of(records)
    assert (summary.successes, summary.attempts, summary.delivered, summary.parts_total) == (3, 4, 3, 40)
    assert summary.gsr == 0.75
    assert summary.dr == 3 / 40
    assert summary.intervals["gsr"] == wilson_interval(3, 4)
    assert summary.intervals["dr"] == wilson_interval(3, 40)


def test_picks_per_hour_follow_from_the_means_over_attempts(records: list[BinRecord]) -> None:
    summary = summary_of(records)
    motion = (3 * 5.25 + 2.0) / 4
    assert summary.time == pytest.approx({"sense": 0.5, "compute": 0.25, "motion": motion, "concurrent": 0.0})
    assert summary.mpph == pytest.approx(3600 * 0.75 / (0.75 + motion))
    assert summary.motion_dph == pytest.approx(3600 * 0.75 / motion)
    low, high = summary.intervals["mpph"] or (np.nan, np.nan)
    assert low < summary.mpph < high


def test_time_that_passes_during_the_motion_before_counts_once(records: list[BinRecord]) -> None:
    early = [replace(r, picks=tuple(replace(p, t_concurrent=0.5) for p in r.picks)) for r in records]
    before, after = summary_of(records), summary_of(early)
    assert after.time == before.time | {"concurrent": 0.5}
    assert before.mpph_overlapped == before.mpph == after.mpph is not None
    assert after.mpph_overlapped is not None
    assert 3600 * 0.75 / after.mpph_overlapped == pytest.approx(3600 * 0.75 / after.mpph - 0.5)
    assert after.motion_dph == before.motion_dph


def test_the_time_of_pushes_counts_and_they_are_no_attempts(records: list[BinRecord]) -> None:
    without = summary_of(records)
    summary = summary_of([*records, record(2, abstain(), pushed(), pushed(PushOutcome.FREED))])
    assert (summary.attempts, summary.gsr, summary.time) == (without.attempts, without.gsr, without.time)
    assert {name: count for name, count in summary.pushes.items() if count} == {"freed": 1, "moved": 1}
    assert set(summary.pushes) == {str(kind) for kind in PushOutcome}
    assert without.mpph is not None
    seconds = 3600 * 3 / without.mpph
    assert summary.mpph == pytest.approx(3600 * 3 / (seconds + 2 * 4.0))
    assert "pushes by outcome" in result_table(summary)
    assert "pushes" not in result_table(without)


@pytest.mark.parametrize(("bins", "shown"), [(4, "from 5 bins on"), (5, "GSR 100.0 to 100.0 %")])
def test_intervals_over_few_bins_are_not_printed(bins: int, shown: str) -> None:
    table = result_table(summary_of([record(index, attempt(DELIVERED)) for index in range(bins)]))
    assert shown in next(line for line in table.splitlines() if line.startswith("over bins"))


def test_what_the_detectors_of_doubles_said_is_counted_and_printed() -> None:
    double = DoubleCheck(jaw_excess=0.0, load=2.0, jaw=False, weight=True, held=2)
    lifts = [replace(attempt(DELIVERED), double_check=replace(double, held=1, weight=False, load=1.0))] * 3
    summary = summary_of([record(0, *lifts, replace(attempt(GraspOutcome.PUT_BACK), double_check=double))])
    assert (summary.doubles["lifts"], summary.doubles["doubles"]) == (4, 1)
    assert summary.doubles["weight"] == {"detected": 1, "missed": 0, "false_alarms": 0}
    assert (summary.attempts, summary.gsr, summary.outcomes["put_back"]) == (4, 0.75, 1)
    table = result_table(summary)
    assert "more than one part lifted   1 of 4 lifts" in table
    assert "found by the weight       1 detected, 0 missed, 0 false alarms" in table
    assert "image" not in table
    seen = replace(attempt(GraspOutcome.PUT_BACK), double_check=replace(double, gone=1.2, image=True))
    assert "found by the image        1 lifts, 1 detected, 0 missed, 0 false alarms" in result_table(
        summary_of([record(0, *lifts, seen)])
    )


def test_wall_clock_leaves_the_drop_out_of_an_attempt(records: list[BinRecord]) -> None:
    assert summary_of(records).wall == {"attempt": 5.0, "bin": 12.0, "render_share": 0.25}


def test_causes_that_do_not_occur_count_zero(records: list[BinRecord]) -> None:
    summary = summary_of(records)
    assert summary.outcomes == {str(kind): 0 for kind in GraspOutcome} | {"delivered": 3, "missed": 1}
    assert summary.abstentions == {"no_candidate": 1, "no_clear_approach": 0, "ik_infeasible": 1}
    assert summary.termination == {"empty": 0, "2F": 0, "abstained": 2, "time": 0}


def test_intervals_over_bins_resample_whole_bins(records: list[BinRecord]) -> None:
    twins = summary_of([record(k, attempt(DELIVERED), attempt(MISSED)) for k in range(5)])
    assert twins.intervals["gsr_bins"] == (0.5, 0.5)  # every bin alike: bins carry no doubt, however few attempts
    assert twins.intervals["dr_bins"] == pytest.approx((0.1, 0.1))
    apart = summary_of([record(k, *[attempt(DELIVERED if k % 2 else MISSED)] * 10) for k in range(10)])
    over_bins, wilson = apart.intervals["gsr_bins"], apart.intervals["gsr"]
    assert over_bins is not None
    assert wilson is not None
    assert over_bins[1] - over_bins[0] > 2 * (wilson[1] - wilson[0])  # 10 independent bins, not 100 attempts
    assert summary_of(records[:1]).intervals["gsr_bins"] is None
    assert "resampling whole bins: GSR 50.0 to 50.0 %, DR 10.0 to 10.0 %" in result_table(twins)


def test_lost_parts_are_counted_apart_from_those_left(records: list[BinRecord]) -> None:
    summary = summary_of([*records, record(2, attempt(GraspOutcome.DOUBLE), lost=2)])
    assert summary.lost == 2
    assert "parts         3 delivered, 2 lost, 45 left in the bin" in result_table(summary)


def test_clutter_weighs_bins_by_their_parts(records: list[BinRecord]) -> None:
    summary = summary_of(records)
    assert summary.clutter["parts"] == 40
    assert summary.clutter["below_half"] == pytest.approx(0.5)
    assert summary.clutter["median"] == pytest.approx(0.5)


def test_results_json_holds_the_contracts_keys(records: list[BinRecord]) -> None:
    values = json.loads(json_text(summary_of(records).plain()))
    assert set(values) >= CONTRACT
    assert values["failure_attribution"] == values["blame"]
    assert values["ap"] is None
    assert values["candidate_pose_accuracy"] is None
    assert values["versions"]["mujoco"]
    assert values["config"]["sensor"] == "good"


def test_without_attempts_rates_are_unknown_and_not_zero() -> None:
    summary = summary_of([record(0, abstain(), abstain())])
    assert (summary.gsr, summary.mpph, summary.time["motion"]) == (None, None, None)
    assert summary.intervals["gsr"] == (0.0, 1.0)
    assert "–" in result_table(summary)
    json_text(summary.plain())


def test_an_empty_bin_has_no_clutter() -> None:
    summary = summary_of([record(0, parts=0)])
    assert summary.clutter == {"median": None, "below_half": None, "above_nine_tenths": None, "parts": 0}


def test_records_of_different_configurations_are_not_summarised(records: list[BinRecord]) -> None:
    with pytest.raises(ValueError, match=r"bins \[1\] are of another configuration"):
        summary_of([records[0], replace(records[1], config_hash="?")])
    with pytest.raises(ValueError, match="no bin was evaluated"):
        summary_of([])


def test_the_table_shows_the_numbers(records: list[BinRecord]) -> None:
    table = result_table(summary_of(records))
    for text in ("75.0 %", "3/4", "7.5 %", "3/40", "30.1 to 95.4 %", "ik_infeasible", "2 bins", "sensor good"):
        assert text in table
    assert "slipped" not in table
    assert max(map(len, table.splitlines())) <= 100


def test_the_table_warns_of_bins_of_different_commits(records: list[BinRecord]) -> None:
    mixed = [replace(records[0], git_commit="aaa"), replace(records[1], git_commit="bbb")]
    assert "NOTE  bins of 2 different commits: aaa, bbb" in result_table(summary_of(mixed))


def test_failed_attempts_are_counted_by_stage_and_shown_beside_perception() -> None:
    picks = [attempt(MISSED), attempt(MISSED), attempt(DELIVERED), attempt(GraspOutcome.COLLIDED)]
    facts = {"config_hash": CONFIG.digest(), "index": 0, "wall": 9.0, "settle": 1.0, "render": 1.0}
    first = BinRecord.from_result(bin_result(*picks), [""] * 4, [compared(True, False)], **facts)
    assert [pick.failure_attribution for pick in first.picks] == ["grasp", "grasp", None, "physics"]
    second = BinRecord.from_result(bin_result(attempt(MISSED)), [""], [compared(False, True, overlap=0.3)], **facts)
    summary = summary_of([first, second])
    assert summary.failure_attribution == {"segment": 1, "pose": 0, "grasp": 2, "physics": 1}
    assert (summary.failures, summary.candidates, summary.candidate_pose_accuracy) == (4, 4, 0.5)
    table = result_table(summary)
    assert "failed attempts by stage    segment" in table
    head = table.splitlines()[2:6]
    assert head[0].split() == ["AP", "pose", "accuracy", "recall", "GSR", "DR"]
    # Beside what is right stands how much is found: half of the parts, and one of twenty delivered.
    assert head[1].split() == ["–", "50.0", "%", "50.0", "%", "20.0", "%", "5.0", "%"]
    assert [cell.strip() for cell in head[2].split("  ") if cell] == [
        "segmentation",
        "of 4 poses",
        "of 4 parts",
        "of 5 attempts",
        "of 20 parts",
    ]


def test_what_the_ground_truth_gave_is_labelled_in_the_table(records: list[BinRecord]) -> None:
    for perception, labelled in (("learned", 0), ("gt_masks", 1), ("oracle", 3)):
        config = replace(CONFIG, perception=perception)
        made = [replace(each, config_hash=config.digest()) for each in records]
        head = result_table(summarise(made, config, np.random.default_rng(0))).splitlines()[3]
        assert head.split().count("given") == labelled


def test_columns_are_aligned() -> None:
    assert columns([("name", "n"), ("a", "100")]) == "name    n\na     100"

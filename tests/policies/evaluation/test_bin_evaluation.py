import dataclasses
import json
import logging
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from binpick_env.config import CameraConfig
from perception.runtime.records import RecordError
from policies.evaluation.bin_evaluation import BinError, evaluate_bin
from policies.evaluation.cell import Cell, CellCache, scripted_cell
from policies.evaluation.config import EvaluationConfig, bin_seed
from policies.evaluation.jobs import FolderError, Job, run_job
from policies.evaluation.records import BinRecord, load_record, record_path, save_record
from policies.evaluation.tables import found_note
from policies.grasping.outcomes import Abstention, DoubleCheck, GraspOutcome, PickResult
from policies.picking.settings import PickerSettings
from tests.policies.fake_cell import FakeEnv, ScriptPicker, abstain, attempt, broken_cell, dice_cell, pushed

CONFIG = EvaluationConfig(num_parts=(6, 6))


def outcome_of(record: BinRecord) -> tuple[object, ...]:
    """Return everything in a record except for wall clock."""
    return record.index, record.seed, record.picks, record.delivered, record.termination, record.clutter


def counted(made: list[int]):
    def make(config: EvaluationConfig) -> Cell:
        made.append(1)
        return dice_cell(config)

    return make


# --- seeds ---------------------------------------------------------------------------------------------------------


def test_every_record_is_that_of_its_own_seed(tmp_path: Path) -> None:
    records = run_job(CONFIG, Job(out=tmp_path, bins=3), make_cell=dice_cell)
    assert [record.seed for record in records] == [bin_seed(0, index) for index in range(3)]


# --- one bin -------------------------------------------------------------------------------------------------------


def test_a_record_keeps_the_facts_of_each_decision() -> None:
    def make(config: EvaluationConfig) -> Cell:
        env = FakeEnv(parts=2, render_time=0.25)
        delivered = attempt(GraspOutcome.DELIVERED)
        script = attempt(GraspOutcome.MISSED), abstain(Abstention.IK_INFEASIBLE), delivered, delivered
        return Cell(env, ScriptPicker(env, *script))  # type: ignore[arg-type]

    record = evaluate_bin(CONFIG, 3, cells=CellCache(make))
    assert [pick.outcome for pick in record.picks] == ["missed", None, "delivered", "delivered"]
    assert record.picks[1].abstention == "ik_infeasible"
    assert (record.picks[0].width, record.picks[0].opening, record.picks[0].score) == (0.03, 0.05, 0.7)
    assert record.picks[0].features == {"quality": 0.5}
    assert record.picks[1].width is None
    assert (record.delivered, record.parts_total, len(record.attempts)) == (2, 2, 3)
    assert record.render == pytest.approx(0.25 * 5)  # the first frame, three attempts, one look
    assert record.config_hash == CONFIG.digest()


def test_each_frame_is_recorded_once_and_failures_are_attributed() -> None:
    def make(config: EvaluationConfig) -> Cell:
        env = FakeEnv(parts=2)
        delivered = attempt(GraspOutcome.DELIVERED)
        script = attempt(GraspOutcome.MISSED), abstain(Abstention.IK_INFEASIBLE), delivered, delivered
        return Cell(env, ScriptPicker(env, *script))  # type: ignore[arg-type]

    record = evaluate_bin(CONFIG, 3, cells=CellCache(make))
    assert [frame.frame_id for frame in record.frames] == [0, 1, 2, 3]  # a look after the abstention, none at the end
    assert [pick.frame_id for pick in record.picks] == [0, 1, 2, 3]
    assert [pick.failure_attribution for pick in record.picks] == ["grasp", None, None, None]
    assert [pick.candidate for pick in record.picks] == [0, None, 0, 0]
    candidate = record.candidate(record.picks[0])
    assert candidate is not None
    assert (candidate.part, candidate.right) == (1, True)
    assert record.candidate(record.picks[1]) is None
    assert record.frame(4) is None


def test_two_decisions_on_one_frame_record_it_once() -> None:
    def make(config: EvaluationConfig) -> Cell:
        env = FakeEnv(parts=2)
        env.look = lambda **_: None  # type: ignore[method-assign]
        return Cell(env, ScriptPicker(env, abstain(), abstain()))  # type: ignore[arg-type]

    record = evaluate_bin(CONFIG, 3, cells=CellCache(make))
    assert (len(record.picks), len(record.frames)) == (2, 1)


def test_a_record_survives_its_file(tmp_path: Path) -> None:
    record = evaluate_bin(CONFIG, 0, cells=CellCache(dice_cell))
    assert load_record(save_record(record, tmp_path)) == record
    assert [path.name for path in tmp_path.iterdir()] == ["bin_0000.json"]  # no draft is left


def test_pushes_and_checks_survive_their_file_and_records_of_earlier_versions_have_none(tmp_path: Path) -> None:
    def make(config: EvaluationConfig) -> Cell:
        env = FakeEnv(parts=2)
        check = DoubleCheck(jaw_excess=0.001, load=1.1, jaw=False, weight=False, held=1)
        lifted = replace(attempt(GraspOutcome.MISSED), double_check=check)
        return Cell(env, ScriptPicker(env, lifted, pushed(), abstain(), abstain()))  # type: ignore[arg-type]

    record = evaluate_bin(CONFIG, 0, cells=CellCache(make))
    assert [str(pick.ending) for pick in record.picks] == ["missed", "moved", "no_candidate", "no_candidate"]
    assert (len(record.attempts), len(record.timed)) == (1, 2)
    assert record.picks[0].double_check is not None
    path = save_record(record, tmp_path)
    assert load_record(path) == record
    values = json.loads(path.read_text())
    for pick in values["picks"]:
        del pick["push"], pick["double_check"]
    path.write_text(json.dumps(values))
    assert [(pick.push, pick.double_check) for pick in load_record(path).picks] == [(None, None)] * 4


def test_the_cell_is_closed_and_decisions_are_reported() -> None:
    env = FakeEnv(parts=1)
    seen: list[PickResult] = []
    made = Cell(env, ScriptPicker(env, attempt(GraspOutcome.DELIVERED)))  # type: ignore[arg-type]
    with CellCache(lambda _: made) as cells:
        evaluate_bin(CONFIG, 0, on_pick=seen.append, cells=cells)
        assert not env.closed
    assert env.closed
    assert len(seen) == 1


def test_a_crash_names_the_bin_and_its_seed() -> None:
    with pytest.raises(BinError, match=rf"bin 2 \(seed {bin_seed(0, 2)}\) failed: FloatingPointError: the physics"):
        evaluate_bin(CONFIG, 2, cells=CellCache(broken_cell))


# --- one cell for many bins ----------------------------------------------------------------------------------------


def test_one_cell_serves_all_bins_and_is_closed(tmp_path: Path) -> None:
    cells: list[Cell] = []

    def make(config: EvaluationConfig) -> Cell:
        cells.append(dice_cell(config))
        return cells[-1]

    records = run_job(CONFIG, Job(out=tmp_path, bins=3), make_cell=make)
    (cell,) = cells
    assert cell.env.closed  # type: ignore[attr-defined]
    assert outcome_of(evaluate_bin(CONFIG, 2, cells=CellCache(dice_cell))) == outcome_of(records[2])


def test_another_configuration_and_a_crash_get_another_cell() -> None:
    made: list[int] = []
    cells = CellCache(counted(made))
    first = cells.cell(CONFIG)
    assert cells.cell(CONFIG) is first
    assert cells.cell(dataclasses.replace(CONFIG, seed=1)) is not first
    assert first.env.closed  # type: ignore[attr-defined]

    def crash(result: PickResult) -> None:
        raise FloatingPointError("one\ntwo")

    with pytest.raises(BinError, match="FloatingPointError: one two"):
        evaluate_bin(CONFIG, 0, on_pick=crash, cells=cells)
    cells.cell(CONFIG)
    assert len(made) == 4


@pytest.mark.slow
def test_a_bin_alone_equals_the_same_bin_after_others() -> None:
    config = EvaluationConfig(num_parts=(2, 2), camera=CameraConfig(width=320, height=240), perception="oracle")

    def facts(record: BinRecord) -> list[tuple[object, ...]]:
        return [(p.outcome, p.abstention, p.part, p.width, p.score, p.t_motion, p.frame_id) for p in record.picks]

    with CellCache(scripted_cell) as cells:
        alone = evaluate_bin(config, 1, cells=cells)
        evaluate_bin(config, 0, cells=cells)
        after = evaluate_bin(config, 1, cells=cells)
    assert facts(after) == facts(alone)
    assert (after.delivered, after.clutter) == (alone.delivered, alone.clutter)


def test_evaluation_computes_on_one_core_and_restores_the_threads(tmp_path: Path) -> None:
    before, seen = cv2.getNumThreads(), []
    cv2.setNumThreads(2)
    try:
        run_job(CONFIG, Job(out=tmp_path, bins=1), None, lambda _: seen.append(cv2.getNumThreads()),
                dice_cell)  # fmt: skip
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)
    assert set(seen) == {1}


# --- resuming ------------------------------------------------------------------------------------------------------


def test_finished_bins_are_not_computed_again(tmp_path: Path) -> None:
    first = run_job(CONFIG, Job(out=tmp_path, bins=2), make_cell=dice_cell)
    made: list[int] = []
    second = run_job(CONFIG, Job(out=tmp_path, bins=3), make_cell=counted(made))
    assert second[:2] == first
    assert len(made) == 1


def test_existing_records_are_reported_and_fresh_computes_them_again(tmp_path: Path) -> None:
    run_job(CONFIG, Job(out=tmp_path, bins=2), make_cell=dice_cell)
    reported: list[int] = []
    job = Job(out=tmp_path, bins=3)
    run_job(CONFIG, job, make_cell=dice_cell, on_found=lambda found: reported.append(len(found)))
    assert reported == [2]
    made: list[int] = []
    fresh = dataclasses.replace(job, fresh=True)
    run_job(CONFIG, fresh, make_cell=counted(made), on_found=lambda found: reported.append(len(found)))
    assert (reported, made) == ([2], [1])


def test_the_note_warns_of_other_code() -> None:
    record = dataclasses.replace(evaluate_bin(CONFIG, 0, cells=CellCache(dice_cell)), git_commit="aaa")
    assert found_note([record], 3, "aaa") == "1 of 3 bins were there already, made by commit aaa"
    assert "\nWARNING  this code is commit bbb: --fresh computes" in found_note([record], 3, "bbb")


@pytest.mark.parametrize("damage", ["", "{", '{"version": 2}', '{"version": 0}', "[]", "cut", "frame"])
def test_a_damaged_record_is_computed_again(tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    first = run_job(CONFIG, Job(out=tmp_path, bins=2), make_cell=dice_cell)
    path = record_path(tmp_path, 1)
    whole = path.read_text()
    cut = {"cut": whole[:-40], "frame": whole.replace('"visible_fractions"', '"visible"')}
    path.write_text(cut.get(damage, damage))
    with caplog.at_level(logging.WARNING):
        second = run_job(CONFIG, Job(out=tmp_path, bins=2), make_cell=dice_cell)
    assert [outcome_of(r) for r in first] == [outcome_of(r) for r in second]
    assert load_record(path) == second[1]
    assert "bin 1 is computed again" in caplog.text


def test_a_record_of_an_earlier_version_names_the_failure_attribution_blame(tmp_path: Path) -> None:
    def make(config: EvaluationConfig) -> Cell:
        env = FakeEnv(parts=2)
        return Cell(env, ScriptPicker(env, attempt(GraspOutcome.MISSED), abstain(), abstain()))  # type: ignore[arg-type]

    record = evaluate_bin(CONFIG, 0, cells=CellCache(make))
    assert [pick.failure_attribution for pick in record.picks] == ["grasp", None, None]
    path = save_record(record, tmp_path)
    values = json.loads(path.read_text())
    for pick in values["picks"]:  # both names are written for one version
        assert pick["blame"] == pick.pop("failure_attribution")
    path.write_text(json.dumps(values))
    assert load_record(path) == record


def test_a_record_with_an_unknown_word_is_refused(tmp_path: Path) -> None:
    path = save_record(evaluate_bin(CONFIG, 0, cells=CellCache(dice_cell)), tmp_path)
    values = json.loads(path.read_text())
    values["picks"][0]["outcome"] = "vanished"
    path.write_text(json.dumps(values))
    with pytest.raises(RecordError, match=r"does not hold a complete bin record.*vanished"):
        load_record(path)


def test_a_record_of_another_bin_is_not_taken(tmp_path: Path) -> None:
    run_job(CONFIG, Job(out=tmp_path, bins=1), make_cell=dice_cell)
    record_path(tmp_path, 1).write_text(record_path(tmp_path, 0).read_text())
    records = run_job(CONFIG, Job(out=tmp_path, bins=2), make_cell=dice_cell)
    assert records[1].index == 1


def test_another_configuration_in_the_folder_is_refused(tmp_path: Path) -> None:
    run_job(CONFIG, Job(out=tmp_path, bins=1), make_cell=dice_cell)
    other = dataclasses.replace(CONFIG, seed=1, sensor="none")
    with pytest.raises(FolderError, match=r"seed: 0 there, 1 here, sensor: good there, none here.*--out"):
        run_job(other, Job(out=tmp_path, bins=1), make_cell=dice_cell)


def test_of_nested_settings_only_those_that_differ_are_named(tmp_path: Path) -> None:
    run_job(CONFIG, Job(out=tmp_path, bins=1), make_cell=dice_cell)
    other = dataclasses.replace(CONFIG, picker=PickerSettings(standoff=0.05))
    with pytest.raises(FolderError, match=r"evaluation \(picker.standoff: 0.06 there, 0.05 here\); choose"):
        run_job(other, Job(out=tmp_path, bins=1), make_cell=dice_cell)


def test_a_damaged_file_of_the_configuration_is_written_anew(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text("{")
    run_job(CONFIG, Job(out=tmp_path, bins=1), make_cell=dice_cell)
    assert json.loads((tmp_path / "config.json").read_text())["hash"] == CONFIG.digest()


def test_an_interrupt_loses_no_finished_bin(tmp_path: Path) -> None:
    done: list[BinRecord] = []

    def interrupted(record: BinRecord) -> None:
        done.append(record)
        if len(done) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(CONFIG, Job(out=tmp_path, bins=5), on_bin=interrupted, make_cell=dice_cell)
    assert sorted(path.name for path in tmp_path.glob("bin_*.json")) == ["bin_0000.json", "bin_0001.json"]

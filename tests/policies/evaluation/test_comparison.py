"""Two runs of the same bins: what is compared, what is refused, and what stands on the page."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from perception.runtime.records import RecordError
from policies.commands import compare
from policies.evaluation.comparison import ComparisonError, compare_runs, load_run
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import ensure_folder_config
from policies.evaluation.records import BinRecord, record_path, save_record
from policies.grasping.outcomes import GraspOutcome
from policies.report.comparison_report import comparison_table
from tests.policies.evaluation.test_frame_summary import compared, frame
from tests.policies.fake_cell import attempt, bin_result

CONFIG = EvaluationConfig(seed=3)
DELIVERED, MISSED = attempt(GraspOutcome.DELIVERED), attempt(GraspOutcome.MISSED)
Save = Callable[..., Path]


@pytest.fixture
def save(tmp_path: Path) -> Save:
    """Return a function that writes a run: for each bin, the numbers of its deliveries and of its failures."""

    def write(name: str, *bins: tuple[int, int], config: EvaluationConfig = CONFIG, parts: int = 10) -> Path:
        folder = tmp_path / name
        ensure_folder_config(config, folder)
        for index, (delivered, missed) in enumerate(bins):
            picks = [DELIVERED] * delivered + [MISSED] * missed
            facts = {"config_hash": config.digest(), "index": index, "wall": 9.0, "settle": 1.0, "render": 1.0}
            seen = frame(compared(0), compared(1, right=delivered > missed))
            result = bin_result(*picks, seed=100 + index, parts=parts)
            save_record(BinRecord.from_result(result, [""] * len(picks), [seen], **facts), folder)
        return folder

    return write


def test_differences_are_those_of_the_pooled_numbers_second_minus_first(save: Save) -> None:
    first, second = save("a", (5, 5), (8, 0), (2, 2)), save("b", (6, 2), (8, 0), (4, 0))
    comparison = compare_runs(load_run(first), load_run(second))
    gsr, dr = comparison.numbers["gsr"], comparison.numbers["dr"]
    assert (gsr.first, gsr.second) == (15 / 22, 18 / 20)
    assert gsr.difference == pytest.approx(18 / 20 - 15 / 22)
    assert dr.difference == pytest.approx(3 / 30)
    assert dr.low is not None
    assert dr.high is not None
    assert dr.low <= dr.difference <= dr.high
    assert comparison.numbers["mpph"].difference == pytest.approx(600 * (18 / 20 - 15 / 22))
    overlapped = comparison.numbers["mpph_overlapped"]
    assert overlapped.difference == comparison.numbers["mpph"].difference  # nothing is concurrent
    recognition = comparison.numbers["candidate_pose_accuracy"]
    assert (recognition.first, recognition.second) == (4 / 6, 1.0)
    assert comparison.numbers["ap"].difference is None  # nothing is segmented here
    assert [each.delivered for each in comparison.bins] == [(5, 6), (8, 8), (2, 4)]


def test_a_run_does_not_differ_from_itself(save: Save) -> None:
    run = load_run(save("a", (5, 5), (8, 0)))
    comparison = compare_runs(run, run)
    assert {(n.difference, n.low, n.high) for n in comparison.numbers.values()} == {(0.0, 0.0, 0.0), (None,) * 3}
    assert comparison.settings == {}
    assert "both runs have the same settings" in comparison_table(comparison)


def test_what_the_ground_truth_gave_is_not_compared(save: Save) -> None:
    oracle = save("oracle", (5, 5), (8, 0), config=replace(CONFIG, perception="oracle"))
    comparison = compare_runs(load_run(save("a", (5, 5), (8, 0))), load_run(oracle))
    recall = comparison.numbers["candidate_recall"]
    assert (recall.second, recall.difference, recall.given) == (None, None, ("second",))
    assert comparison.settings == {"perception": ("learned", "oracle")}
    lines = comparison_table(comparison).splitlines()
    assert [line.split()[-4:-1] for line in lines if line.startswith("recall")] == [["75.0", "given", "–"]]


@pytest.mark.parametrize(("bins", "interval"), [(4, "–"), (5, "+0.0")])
def test_intervals_over_few_bins_are_not_shown(save: Save, bins: int, interval: str) -> None:
    run = load_run(save("a", *[(5, 5)] * bins))
    lines = comparison_table(compare_runs(run, run)).splitlines()
    assert next(line.split() for line in lines if line.startswith("GSR"))[-1] == interval


def test_bins_of_one_run_alone_are_left_out_and_named(save: Save) -> None:
    comparison = compare_runs(load_run(save("a", (1, 1), (2, 0), (3, 0))), load_run(save("b", (1, 1))))
    assert comparison.left_out == (1, 2)
    assert len(comparison.bins) == 1
    assert comparison.numbers["gsr"].low is None  # one bin has no interval
    assert "left out, in one run only: bins 1, 2" in comparison_table(comparison)


@pytest.mark.parametrize(
    ("other", "parts", "message"),
    [
        (replace(CONFIG, part="bracket"), 10, "part is tee in the first and bracket in the second"),
        (replace(CONFIG, seed=4), 10, "seed is 3 in the first and 4 in the second"),
        (replace(CONFIG, num_parts=(5, 6)), 10, r"num_parts is \[20, 30\] in the first and \[5, 6\]"),
        (CONFIG, 11, "bin 0 has 10 parts from seed 100 in the first, 11 from seed 100 in the second"),
    ],
)
def test_other_bins_are_not_comparable(save: Save, other: EvaluationConfig, parts: int, message: str) -> None:
    first, second = save("a", (1, 1)), save("b", (1, 1), config=other, parts=parts)
    with pytest.raises(ComparisonError, match=message):
        compare_runs(load_run(first), load_run(second))


def test_runs_without_a_common_bin_are_not_comparable(save: Save) -> None:
    first, second = save("a", (1, 1), (1, 1)), save("b", (1, 1))
    record_path(first, 0).unlink()
    with pytest.raises(ComparisonError, match="they have no bin in common"):
        compare_runs(load_run(first), load_run(second))


def test_a_folder_that_holds_no_run_is_named(save: Save, tmp_path: Path) -> None:
    save("budget/oracle", (1, 1))
    with pytest.raises(ComparisonError, match=r"has no config\.json; did you mean one of .*: oracle\?"):
        load_run(tmp_path / "budget")
    with pytest.raises(ComparisonError, match="has no finished bin"):
        load_run(save("empty"))
    (tmp_path / "empty" / "config.json").write_text("{")
    with pytest.raises(ComparisonError, match=r"config\.json is damaged"):
        load_run(tmp_path / "empty")


def test_the_command_prints_the_table_and_writes_numbers_and_page(
    save: Save, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [str(save("a", (5, 5), (8, 0))), str(save("b", (6, 2), (8, 0)))]
    files = ["--json", str(tmp_path / "c.json"), "--html", str(tmp_path / "c.html")]
    assert compare.main([*runs, *files]) == 0
    assert "GSR, grasp success [%]" in capsys.readouterr().out
    assert json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["numbers"]["dr"][
        "difference"
    ] == pytest.approx(0.05)
    assert "<td class=n>+5.0</td>" in (tmp_path / "c.html").read_text(encoding="utf-8")
    assert compare.main([runs[0], str(tmp_path)]) == 2
    assert "is no folder of `binpick pick`" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "value"), [("hash", {}), ("hash", 3), ("config", 7), ("config", [1])])
def test_a_configuration_of_other_types_is_refused(name: str, value: object, save: Save) -> None:
    folder = save("a", (1, 1))
    path = folder / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | {name: value}))
    with pytest.raises(ComparisonError, match=r"config\.json is damaged: its hash must be text, and its config"):
        load_run(folder)


@pytest.mark.parametrize(("name", "value"), [("delivered", None), ("git_commit", 7), ("wall", "long"), ("seed", 1.5)])
def test_a_record_of_other_types_is_refused(name: str, value: object, save: Save) -> None:
    folder = save("a", (1, 1))
    path = record_path(folder, 0)
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | {name: value}))
    with pytest.raises(RecordError, match=rf"does not hold a complete bin record \({name} must be "):
        load_run(folder)

"""Two made-up checkouts are compared; each runs in a process of its own, as real ones do."""

import json
from pathlib import Path

import pytest

from policies.benchmarks.builds import comparison
from policies.benchmarks.builds.comparison import NEW_PROCESSES, commit_of, compare_builds, save_comparison
from policies.benchmarks.builds.inputs import BuildJob
from policies.benchmarks.builds.process import BuildError, BuildProcess, require_checkout
from policies.commands import bench
from tests.policies.benchmarks.builds.fake_checkout import fake_checkout, save_small_inputs

JOB = BuildJob(work="frame", repeats=3)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "save_inputs", save_small_inputs)


def test_two_builds_take_turns_on_the_same_inputs(tmp_path: Path) -> None:
    old, new = fake_checkout(tmp_path / "old", found=2, older=True), fake_checkout(tmp_path / "new")
    told: list[int] = []
    compared = compare_builds(old, JOB, here=new, progress=told.append)
    calls = (tmp_path / "calls.txt").read_text().split("\n")[:-1]
    once = ["old 0", "new 0"]
    assert calls == [*once, *once, "old 1", "new 1", "old 2", "new 2", *NEW_PROCESSES * once]
    assert told == [1, 2, 3]
    assert compared.facts == ((1, 1), (2, 2), (2, 3))
    assert compared.same == 2
    first = "first result of a new process"
    assert [row.name for row in compared.rows] == ["frame, wall clock", "frame, processor", "  poses", first]
    assert compared.rows[2].before == compared.rows[2].after == (2.0, 2.0, 2.0)
    assert all(len(row.before) == 3 and min(row.before + row.after) >= 0 for row in compared.rows)
    assert min(compared.rows[3].after) > max(compared.rows[0].after)  # a process has to start
    assert 5 < compared.memory_ready[0] <= compared.memory_peak[0] < 500
    assert "equal results   2 of 3" in str(compared)
    assert "results after   1 2 3" in str(compared)
    save_comparison(tmp_path / "frame.json", compared)
    kept = json.loads((tmp_path / "frame.json").read_text())
    assert {"benchmark", "machine", "command", "versions", "job", "commits", "memory_peak"} <= set(kept)
    assert (kept["rows"][2]["ratio"], kept["rows"][2]["interval"], kept["commits"]) == (1.0, None, ["", ""])


def test_a_build_without_what_the_work_needs_is_named(tmp_path: Path) -> None:
    old, new = fake_checkout(tmp_path / "old"), fake_checkout(tmp_path / "new")
    (old / "perception/pipeline.py").write_text("")
    expected = r"the build in .*old cannot do this work: it has no Pipeline in perception\.pipeline"
    with pytest.raises(ValueError, match=expected):
        compare_builds(old, JOB, here=new)


def test_a_build_that_fails_says_why(tmp_path: Path) -> None:
    old = fake_checkout(tmp_path / "old", trouble="raise ArithmeticError('no pose today')")
    new = fake_checkout(tmp_path / "new")
    with pytest.raises(BuildError, match=r"old failed with exit code 1: ArithmeticError: no pose today"):
        compare_builds(old, JOB, here=new)


def test_a_build_that_is_not_the_checkouts_own_is_refused(tmp_path: Path) -> None:
    old, other = fake_checkout(tmp_path / "old"), fake_checkout(tmp_path / "other")
    (old / "perception").rename(tmp_path / "gone")
    (old / "perception").symlink_to(other / "perception")
    save_small_inputs(tmp_path / "inputs.npz", JOB)
    with pytest.raises(BuildError, match=r"old imported .*other.perception; uninstall that package"):
        BuildProcess(old, "frame", JOB.arguments(tmp_path / "inputs.npz"))


def test_what_is_no_checkout_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "policies").mkdir()
    expected = "must be a checkout of the project, .* it has no perception and no binpick_env. `git worktree add"
    with pytest.raises(ValueError, match=expected):
        require_checkout(tmp_path)
    assert bench.run(bench.Frame(against=tmp_path)) == 2
    assert "it has no perception and no binpick_env" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "value"), [("count", 0), ("repeats", 0), ("threads", -1), ("seed", -1)])
def test_impossible_jobs_are_refused(name: str, value: int) -> None:
    least = "not be negative" if name == "seed" else "be at least 1"
    with pytest.raises(ValueError, match=f"{name} must {least}, got {value}"):
        BuildJob(work="frame", **{name: value})


def test_a_commit_is_named_where_there_is_one(tmp_path: Path) -> None:
    assert commit_of(tmp_path) == ""
    (tmp_path / ".git").mkdir()
    assert commit_of(tmp_path) == ""


def test_the_command_prints_and_keeps_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = fake_checkout(tmp_path / "old"), fake_checkout(tmp_path / "new")
    monkeypatch.setattr(comparison.compare_builds, "__defaults__", (new, None))
    text = bench.Frame(against=old, repeats=2, json=tmp_path / "f.json").report()
    assert "equal results   2 of 2" in text
    job = json.loads((tmp_path / "f.json").read_text())["job"]
    assert (job["repeats"], job["unit"]) == (2, None)

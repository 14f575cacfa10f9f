"""`binpick pick --rerun`, from its mistakes to its file."""

import json
import sys
from pathlib import Path

import pytest

from policies.commands import pick
from policies.evaluation import jobs
from tests.binpick_env.jobs.pickled_map import pickled_map
from tests.policies.commands.command_calls import TINY, run
from tests.rerun_rows import rows_of
from tests.shared_models import share_shaded_meshes


@pytest.fixture(autouse=True, scope="module")
def _meshes_are_shared() -> None:
    share_shaded_meshes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rerun", "bin.mp4"], "a recording's name must end in .rrd"),
        (["--budget", "--rerun", "bin.rrd"], "a budget records none"),
    ],
)
def test_a_mistake_is_one_line_before_anything_is_computed(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert pick.main([*arguments, "--out", str(out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {message}")
    assert not out.exists()


def test_without_the_extra_the_error_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)  # an import of it fails
    arguments = ["--rerun", str(tmp_path / "bin.rrd"), "--out", str(tmp_path / "out")]
    assert pick.main(arguments) == 2
    assert 'pip install "binpick[viz]"' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_worker_that_picks_the_first_bin_records_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "map_indices", pickled_map)  # test_jobs.py starts processes
    monkeypatch.setattr(jobs, "_cells", jobs._cells)  # which a worker's start replaces
    out, path = tmp_path / "out", tmp_path / "new" / "bin.rrd"
    seen = [*TINY, "--perception", "gt_masks", "--no-html", "--out", str(out)]
    assert run("pick", "--bins", "2", "--seed", "31", "--workers", "1", *seen, cwd=tmp_path).returncode == 0
    before = [json.loads((out / f"bin_000{k}.json").read_text())["picks"] for k in range(2)]
    made = [(out / f"bin_000{k}.json").stat().st_mtime_ns for k in range(2)]
    recorded = [*seen, "--fresh", "--rerun", str(path)]
    done = run("pick", "--bins", "2", "--seed", "31", "--workers", "2", *recorded, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    after = [json.loads((out / f"bin_000{k}.json").read_text())["picks"] for k in range(2)]
    for each in [each for picks in (*before, *after) for each in picks]:
        each["t_compute"] = each["t_concurrent"] = 0.0
    assert after == before
    assert made[0] != (out / "bin_0000.json").stat().st_mtime_ns
    assert [each.name for each in path.parent.iterdir()] == ["bin.rrd"]
    rows = rows_of(path)
    assert rows["/log"] == len(before[0])
    assert rows["/world/seen/segments"] == rows["/world/seen/cloud"] >= len({pick["frame_id"] for pick in before[0]})


@pytest.mark.slow
def test_a_bin_that_is_there_is_computed_again_for_its_recording(tmp_path: Path) -> None:
    common = [*TINY, "--part", "part_c", "--bins", "1", "--seed", "31", "--no-html", "--out", str(tmp_path / "out")]
    assert pick.main(common) == 0
    made = (tmp_path / "out" / "bin_0000.json").stat().st_mtime_ns
    assert pick.main([*common, "--rerun", str(tmp_path / "bin.rrd")]) == 0
    assert (tmp_path / "out" / "bin_0000.json").stat().st_mtime_ns > made
    assert rows_of(tmp_path / "bin.rrd")["/log"] >= 1

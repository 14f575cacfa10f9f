import json
from pathlib import Path

import pytest

from binpick_env.cell.settle import SettleError
from policies.benchmarks import cell
from policies.commands import bench, picture
from policies.report import portrait
from tests.policies.commands.command_calls import ROOT, run


def test_a_pile_that_does_not_settle_is_one_line_in_every_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise SettleError("25 parts do not come to rest")

    monkeypatch.setattr(portrait, "cell_picture", fail)
    monkeypatch.setattr(cell, "bench_cell", fail)
    for call in (lambda: picture.main([]), lambda: bench.main(["cell"])):
        assert call() == 2
        assert capsys.readouterr().err == "error: 25 parts do not come to rest\n"


@pytest.mark.slow
def test_bench_measures_and_compares(tmp_path: Path) -> None:
    file, small = str(tmp_path / "cell.json"), ("--width", "640", "--height", "480")
    done = run("bench", "cell", "--repeats", "1", "--picks", "1", "--count", "3", *small, "--save", file)
    assert done.returncode == 0, done.stderr
    rows = {row["name"] for row in json.loads(Path(file).read_text())["rows"]}
    assert {"drop and settle", "attempts", "steps of 0.04 s, picking"} <= rows
    done = run("bench", "cell", "--compare", file, file)
    assert done.returncode == 0, done.stderr
    assert "within noise" in done.stdout
    assert run("bench", "cell", "--compare", str(ROOT / "pyproject.toml"), file).returncode == 2

import json
from pathlib import Path

import pytest
import trimesh

from policies.assessment import run as assessment_run
from policies.commands import assess
from tests.policies.commands.command_calls import run

TINY = ["--scenes", "1", "--bins", "1", "--min-parts", "2", "--max-parts", "2", "--workers", "1", "--sensor", "none"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["teapot"], "part must be one of part_a, part_b, part_c, tee, bracket"),
        (["nowhere.stl"], "nowhere.stl"),
        (["tee", "--part", "bracket"], "name the part once: 'tee' as an argument, or --part bracket"),
        (["tee", "--scenes", "0"], "scenes must be at least 1, got 0"),
        (["tee", "--workers", "0"], "workers must be at least 1, got 0"),
        (["tee", "--jaw", "0.2"], "jaw must be over 0 and at most 0.085 m"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert assess.main([*arguments, "--out", str(tmp_path / "out")]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not (tmp_path / "out").exists()


def test_the_part_is_an_argument_or_an_option() -> None:
    assert assess.Arguments(file="bracket").options().part == "bracket"
    assert assess.Arguments(part="bracket").options().part == "bracket"
    assert assess.Arguments().folder() == Path("runs/assess-tee-7")
    assert assess.Arguments(file="bracket", seed=3).folder() == Path("runs/assess-bracket-3")


def test_ctrl_c_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(assessment_run, "assess", interrupted)
    assert assess.run(assess.Arguments(out=tmp_path)) == 130
    assert f"what is finished is kept in {tmp_path}: the same command resumes there" in capsys.readouterr().err


@pytest.mark.slow
def test_a_part_is_assessed_on_one_page_and_the_same_command_resumes(tmp_path: Path) -> None:
    trimesh.creation.box((80, 40, 25)).export(tmp_path / "block.stl")
    words = ["block.stl", "--unit", "mm", *TINY, "--out", "out"]
    done = run("assess", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[-1] == "report     out/report.html"
    assert lines[-2] == "advice     nothing to change"
    assert "read as mm (given), 80 x 40 x 25 mm, 216 g, symmetry order 4" in lines[0]
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("src='data:image/webp;base64,") == 2  # a pick of each part
    assert "<h2>How it is seen</h2>" in page
    first = json.loads((tmp_path / "out" / "assessment.json").read_text())
    assert first["perception"]["scenes"] == 1
    assert first["picking"]["parts"] == 2
    assert set(first["seconds"]) == {"part", "scenes", "bins"}
    kept = [tmp_path / "out/scenes/scene_00000.npz", tmp_path / "out/picks/learned/bin_0000.json"]
    made = [path.stat().st_mtime_ns for path in kept]
    done = run("assess", *words, "--json", "again.json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [path.stat().st_mtime_ns for path in kept] == made
    again = json.loads((tmp_path / "again.json").read_text())
    for name in ("part", "rests", "grip", "sight", "bin", "perception", "picking", "advice"):
        assert again[name] == first[name]
    done = run("assess", *words, "--friction", "0.4", cwd=tmp_path)
    assert done.returncode == 2
    assert "choose another folder with --out" in done.stderr

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import cv2
import pytest
import trimesh

from binpick_env.settle import SettleError
from policies.evaluation import BinError

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted((ROOT / "scripts").glob("*.py"))
TINY = ["--min-parts", "2", "--max-parts", "2", "--width", "640", "--height", "480", "--sensor", "none"]


def run(script: str, *arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    command = [sys.executable, str(ROOT / "scripts" / script), *arguments]
    return subprocess.run(command, cwd=cwd, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True)


def load(script: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"script_{Path(script).stem}", ROOT / "scripts" / script)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module  # dataclasses look their own module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_help_is_short_and_to_the_point(script: Path) -> None:
    done = run(script.name, "--help")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage:")


def test_help_names_every_argument_of_the_contract() -> None:
    text = run("pick.py", "--help").stdout
    for name in ("part", "bins", "seed", "perception", "sensor", "workers", "out", "json", "video", "html"):
        assert f"--{name}" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "teapot"], "part must be one of part_a, part_b, part_c, tee, bracket"),
        (["--part", "nowhere.stl"], "nowhere.stl"),
        (["--bins", "0"], "bins and workers must be at least 1, got 0 and 1"),
        (["--perception", "learned"], "perception='learned' needs"),
        (["--video", "film.avi"], "must end in .mp4"),
        (["--min-parts", "5", "--max-parts", "4"], "num_parts must be a rising pair"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pick = load("pick.py")
    code = pick.main(pick.tyro.cli(pick.Arguments, args=[*arguments, "--out", str(tmp_path)]))
    error = capsys.readouterr().err
    assert code == 2
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert message in error


def test_ctrl_c_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pick = load("pick.py")

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pick, "run_job", interrupted)
    assert pick.main(pick.Arguments(out=tmp_path)) == 130
    assert f"finished bins are kept in {tmp_path}: the same command goes on from there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (BinError("bin 3 (seed 7) failed: SettleError: no rest"), "bin 3 (seed 7) failed: SettleError: no rest"),
        (BinError("a worker was killed"), "a worker was killed"),
    ],
)
def test_a_bin_that_fails_is_one_line_and_exit_code_2(
    fault: Exception,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pick = load("pick.py")

    def fail(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.setattr(pick, "run_job", fail)
    assert pick.main(pick.Arguments(out=tmp_path)) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line


def test_a_pile_that_does_not_settle_is_one_line_in_every_script(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, bench = load("picture.py"), load("bench.py")

    def fail(*_: object, **__: object) -> None:
        raise SettleError("25 parts do not come to rest")

    monkeypatch.setattr(picture, "portrait", fail)
    monkeypatch.setattr(bench, "bench_cell", fail)
    for run_it in (lambda: picture.main(picture.Arguments()), lambda: bench.cell(bench.Cell())):
        assert run_it() == 2
        assert capsys.readouterr().err == "error: 25 parts do not come to rest\n"


@pytest.mark.slow
def test_pick_runs_resumes_and_refuses_another_configuration(tmp_path: Path) -> None:
    out, film = tmp_path / "run", tmp_path / "film.mp4"
    common = [*TINY, "--out", str(out)]
    done = run("pick.py", "--bins", "1", "--video", str(film), "--video-limit", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "GSR" in done.stdout
    assert film.stat().st_size > 1000
    assert "<img" in (out / "report.html").read_text()
    made = (out / "bin_0000.json").stat().st_mtime_ns
    done = run("pick.py", "--bins", "2", "--workers", "2", "--json", str(tmp_path / "n.json"), *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1 of 2 bins were there already, made by commit" in done.stdout
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["bins"] == 2
    assert numbers["parts_total"] == 4
    assert (out / "bin_0000.json").stat().st_mtime_ns == made
    done = run("pick.py", "--bins", "2", "--seed", "1", *common, cwd=tmp_path)
    assert done.returncode == 2
    assert "--out" in done.stderr


def test_a_file_is_said_as_it_was_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pick = load("pick.py")
    trimesh.creation.box((60, 40, 30)).export(tmp_path / "block.stl")

    def stop(*_: object, **__: object) -> None:
        raise BinError("far enough")

    monkeypatch.setattr(pick, "run_job", stop)
    file = ["--part", str(tmp_path / "block.stl"), "--out", str(tmp_path / "out")]
    for arguments, said in (
        ([], "block.stl: read as mm, d_max 78 mm, symmetry order 4, 2700 kg/m^3"),
        (["--symmetry", "none", "--density", "1240"], "block.stl: read as mm, d_max 78 mm, symmetry order 1, 1240 kg/"),
    ):
        assert pick.main(pick.tyro.cli(pick.Arguments, args=[*file, *arguments])) == 2
        assert said in capsys.readouterr().out
    assert pick.main(pick.tyro.cli(pick.Arguments, args=[*file, "--unit", "inch"])) == 2
    assert "--unit" in capsys.readouterr().err


@pytest.mark.slow
def test_a_part_file_is_picked(tmp_path: Path) -> None:
    trimesh.creation.box((0.05, 0.03, 0.02)).export(tmp_path / "block.stl")
    arguments = ["--part", str(tmp_path / "block.stl"), "--unit", "m", "--bins", "1", "--density", "1000"]
    done = run("pick.py", *arguments, *TINY, "--out", str(tmp_path / "out"), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "block.stl: read as m, d_max 62 mm, symmetry order 4, 1000 kg/m^3" in done.stdout
    assert json.loads((tmp_path / "out" / "results.json").read_text())["config"]["density"] == 1000.0


@pytest.mark.slow
def test_picture_makes_a_picture(tmp_path: Path) -> None:
    done = run("picture.py", "--width", "150", "--height", "100", "--out", str(tmp_path / "new" / "cell.png"))
    assert done.returncode == 0, done.stderr
    picture = cv2.imread(str(tmp_path / "new" / "cell.png"))
    assert picture is not None
    assert picture.shape == (100, 150, 3)
    assert picture.std() > 20
    assert run("picture.py", "--part", "teapot").returncode == 2


@pytest.mark.slow
def test_bench_measures_and_compares(tmp_path: Path) -> None:
    file = str(tmp_path / "cell.json")
    done = run("bench.py", "cell", "--repeats", "1", "--picks", "1", "--count", "3", "--save", file)
    assert done.returncode == 0, done.stderr
    rows = {row["name"] for row in json.loads(Path(file).read_text())["rows"]}
    assert {"drop and settle", "attempts", "steps of 0.04 s, picking"} <= rows
    done = run("bench.py", "cell", "--compare", file, file)
    assert done.returncode == 0, done.stderr
    assert "within noise" in done.stdout
    assert run("bench.py", "cell", "--compare", str(ROOT / "pyproject.toml"), file).returncode == 2

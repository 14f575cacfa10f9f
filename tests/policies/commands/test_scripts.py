import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
import trimesh

from binpick_env.cell.settle import SettleError
from binpick_env.config import CameraConfig
from binpick_env.jobs.process_map import WorkerError
from binpick_env.scenes.synthesis import SceneConfig, ensure_folder_config
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.weights import save_network
from policies.evaluation.bin_evaluation import BinError

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = sorted((ROOT / "scripts").glob("*.py"))
TINY = ["--min-parts", "2", "--max-parts", "2", "--width", "640", "--height", "480", "--sensor", "none"]
TINY += ["--perception", "oracle"]


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
    for name in ("part", "bins", "seed", "perception", "sensor", "workers", "out", "json", "video", "html", "budget"):
        assert f"--{name}" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "teapot"], "part must be one of part_a, part_b, part_c, tee, bracket"),
        (["--part", "nowhere.stl"], "nowhere.stl"),
        (["--bins", "0"], "bins and workers must be at least 1, got 0 and 1"),
        (["--video", "film.avi"], "must end in .mp4"),
        (["--budget", "--video", "film.mp4"], "a budget is three evaluations and films none"),
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
    assert pick.main(pick.Arguments(perception="oracle", out=tmp_path)) == 130
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
    assert pick.main(pick.Arguments(perception="oracle", out=tmp_path)) == 2
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
    common = [*TINY, "--perception", "learned", "--out", str(out)]
    done = run("pick.py", "--bins", "1", "--video", str(film), "--video-limit", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "GSR" in done.stdout
    assert film.stat().st_size > 1000
    assert "src='./bin_0000_pick_00.webp'" in (out / "report.html").read_text()
    assert (out / "bin_0000_pick_00.webp").stat().st_size < 40_000
    assert json.loads((out / "results.json").read_text())["ap"] > 0.5  # from pixels, of two parts
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
    file = ["--part", str(tmp_path / "block.stl"), "--out", str(tmp_path / "out"), "--perception", "oracle"]
    for arguments, said in (
        ([], "block.stl: read as mm, d_max 78 mm, symmetry order 4, 2700 kg/m^3"),
        (["--symmetry", "none", "--density", "1240"], "block.stl: read as mm, d_max 78 mm, symmetry order 1, 1240 kg/"),
    ):
        assert pick.main(pick.tyro.cli(pick.Arguments, args=[*file, *arguments])) == 2
        assert said in capsys.readouterr().out
    assert pick.main(pick.tyro.cli(pick.Arguments, args=[*file, "--unit", "inch"])) == 2
    assert "--unit" in capsys.readouterr().err


@pytest.mark.slow
def test_a_budget_picks_the_same_bins_three_ways(tmp_path: Path) -> None:
    arguments = ["--budget", "--bins", "2", "--workers", "2", "--no-html", *TINY, "--out", str(tmp_path / "out")]
    done = run("pick.py", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "segmentation (gt_masks - learned)" in done.stdout
    numbers = json.loads((tmp_path / "out" / "budget.json").read_text())
    assert set(numbers["costs"]) == {"pose", "segmentation", "both"}
    for mode in ("oracle", "gt_masks", "learned"):
        records = [json.loads((tmp_path / "out" / mode / f"bin_000{k}.json").read_text()) for k in range(2)]
        assert [record["parts_total"] for record in records] == [2, 2]
        assert (records[0]["frames"][0]["segments"] is None) == (mode == "oracle")
        assert numbers["modes"][mode]["config"]["perception"] == mode
    made = (tmp_path / "out" / "gt_masks" / "bin_0001.json").stat().st_mtime_ns
    assert "2 of 2 bins were there already" in run("pick.py", *arguments, cwd=tmp_path).stdout
    assert (tmp_path / "out" / "gt_masks" / "bin_0001.json").stat().st_mtime_ns == made


def test_a_part_without_weights_gets_the_commands_that_make_them_and_the_other_modes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    pick = load("pick.py")
    trimesh.creation.box((60, 40, 30)).export(tmp_path / "block.stl")
    arguments = ["--part", str(tmp_path / "block.stl"), "--perception", "learned", "--out", str(tmp_path / "out")]
    assert pick.main(pick.tyro.cli(pick.Arguments, args=arguments)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    for told in ("scripts/generate_scenes.py", "scripts/train_segmentation.py", "'gt_masks'", "'oracle'"):
        assert told in line
    assert not (tmp_path / "out").exists()


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
def test_picture_makes_one_of_a_segmented_frame(tmp_path: Path) -> None:
    out = tmp_path / "segmentation.png"
    done = run("picture.py", "--show", "segmentation", "--part", "bracket", "--out", str(out))
    assert done.returncode == 0, done.stderr
    picture = cv2.imread(str(out))
    assert picture is not None
    third = picture.shape[1] // 3
    image, truth, prediction = (picture[:, k * third : (k + 1) * third].astype(float) for k in range(3))
    assert np.ptp(image, axis=2).max() == 0
    drawn = np.ptp(truth, axis=2) > 60  # coloured
    assert np.mean(np.abs(truth - prediction).max(axis=2)[drawn] == 0) > 0.7  # most points have their part's colour


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


SCENES = ["--min-parts", "2", "--max-parts", "3", "--width", "320", "--height", "240", "--sensor", "none"]


@pytest.mark.slow
def test_generate_scenes_makes_resumes_and_refuses_another_configuration(tmp_path: Path) -> None:
    out, facts = tmp_path / "scenes", tmp_path / "new" / "facts.json"
    common = [*SCENES, "--out", str(out)]
    done = run("generate_scenes.py", "--count", "2", "--json", str(facts), *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"2 scenes in {out}" in done.stdout
    numbers = json.loads(facts.read_text())
    assert (numbers["out"], numbers["count"]) == (str(out), 2)
    assert numbers["seconds"] > 0
    made = (out / "scene_00000.npz").stat().st_mtime_ns
    done = run("generate_scenes.py", "--count", "3", "--workers", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (out / "scene_00000.npz").stat().st_mtime_ns == made
    scenes = [BoundaryScene.load(path) for path in sorted(out.glob("scene_*.npz"))]
    assert len(scenes) == 3
    assert all(scene.part == "tee" and len(scene.T_cam_parts) in (2, 3) for scene in scenes)
    assert all(scene.K[0, 0] == pytest.approx(600.0) for scene in scenes)


def test_generate_scenes_without_a_folder_names_one_after_part_and_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    generate = load("generate_scenes.py")
    asked: list[object] = []
    monkeypatch.setattr(generate, "generate_scenes", lambda *arguments: asked.append(arguments) or iter([0]))
    args = ["--part", "part_b", "--seed", "3", "--count", "1", "--sensor", "mixed", "--no-jitter", "--workers", "4"]
    assert generate.main(generate.tyro.cli(generate.Arguments, args=[*args, *SCENES[:-2]])) == 0
    assert "1 scenes in runs/scenes-part_b-3" in capsys.readouterr().out
    camera = CameraConfig(width=320, height=240)
    config = SceneConfig(part="part_b", seed=3, num_parts=(2, 3), sensor="mixed", jitter=False, camera=camera)
    assert asked == [(config, 1, Path("runs/scenes-part_b-3"), 4)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "teapot"], "part must be one of part_a, part_b, part_c, tee, bracket"),
        (["--part", "nowhere.stl"], "nowhere.stl"),
        (["--count", "0"], "count and workers must be at least 1, got 0 and 2"),
        (["--workers", "0"], "count and workers must be at least 1, got 1000 and 0"),
        (["--seed", "-1"], "seed must not be negative, got -1"),
        (["--min-parts", "5", "--max-parts", "4"], "num_parts must be (smallest, largest)"),
        (["--width", "8"], "the image must be at least 16 x 16"),
        (["--seed", "2", "--out", "{claimed}"], "another configuration (seed: 0 there, 2 here)"),
    ],
)
def test_generate_scenes_says_a_users_mistake_in_one_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ensure_folder_config(SceneConfig(), tmp_path)
    generate = load("generate_scenes.py")
    arguments = [argument.format(claimed=tmp_path) for argument in arguments]
    out = [] if "--out" in arguments else ["--out", str(tmp_path / "out")]
    assert generate.main(generate.tyro.cli(generate.Arguments, args=[*arguments, *out])) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("fault", "code", "message"),
    [
        (KeyboardInterrupt(), 130, "finished scenes are kept in {out}: the same command goes on from there"),
        (SettleError("30 parts do not come to rest"), 2, "error: 30 parts do not come to rest"),
        (WorkerError("a worker was killed"), 2, "error: a worker was killed"),
        (OSError("No space left on device"), 2, "error: No space left on device"),
    ],
)
def test_generate_scenes_says_what_stopped_it(
    fault: BaseException,
    code: int,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    generate = load("generate_scenes.py")

    def stop(*_: object) -> Iterator[int]:
        yield 0
        raise fault

    monkeypatch.setattr(generate, "generate_scenes", stop)
    assert generate.main(generate.Arguments(out=tmp_path)) == code
    assert message.format(out=tmp_path) in capsys.readouterr().err


JUDGED = ["--min-parts", "2", "--max-parts", "3", "--width", "320", "--height", "240", "--seed", "7"]


@pytest.fixture
def tiny_weights(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.safetensors"
    save_network(path, GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4)), {"parts": ["tee"]})
    return path


@pytest.mark.slow
def test_evaluate_segmentation_judges_resumes_and_refuses_another_method(tmp_path: Path, tiny_weights: Path) -> None:
    out, facts = tmp_path / "run", tmp_path / "new" / "facts.json"
    common = [*JUDGED, "--weights", str(tiny_weights), "--out", str(out)]
    done = run("evaluate_segmentation.py", "--count", "2", "--html", "--gallery", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "tee · tiny.safetensors · sensor good · 2 scenes · seed 7" in done.stdout
    assert "hand-labelled real scenes" in done.stdout.replace("\n", " ")
    assert (out / "report.html").read_text().count("<h3>Scene") == 1
    made = (out / "scene_00000.npz").stat().st_mtime_ns
    arguments = ["--count", "3", "--workers", "1", "--json", str(facts)]
    done = run("evaluate_segmentation.py", *arguments, *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(facts.read_text())
    assert numbers["scenes"] == 3
    assert {"ap", "ap50", "ap75", "ap25", "ms_per_scene", "intervals", "by_visible_fraction", "clutter"} <= set(numbers)
    assert (out / "scene_00000.npz").stat().st_mtime_ns == made
    done = run("evaluate_segmentation.py", "--method", "euclidean", *common, cwd=tmp_path)
    assert done.returncode == 2
    assert "choose another folder with --out" in done.stderr


@pytest.mark.slow
def test_evaluate_segmentation_prints_the_ablation(tmp_path: Path) -> None:
    out = tmp_path / "ablation"
    for use, seed in (("training", "0"), ("validation", "1")):
        make = ["--part", "part_a", "--count", "1", "--seed", seed, "--out", str(out / use), *JUDGED[:-2]]
        assert run("generate_scenes.py", *make, cwd=tmp_path).returncode == 0
    given = ["--scenes", str(out / "training"), "--validation", str(out / "validation")]
    budget = ["--count", "1", "--steps", "1", "--training-seeds", "1", "--workers", "1"]
    arguments = ["--ablation", "--part", "part_a", *given, *budget, *JUDGED, "--out", str(out)]
    done = run("evaluate_segmentation.py", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    added = ("+ focal double hinge", "+ distance mask", "+ all points grouped")
    for row in ("Euclidean components", "SGPN: PointNet", "DGCNN", *added, "ours"):
        assert f"\n{row}" in done.stdout
    numbers = json.loads((out / "results.json").read_text())
    paper = [row["paper"]["ap50"] if row["paper"] else None for row in numbers["rows"]]
    assert paper == [None, 0.127, 0.276, 0.461, 0.505, None, None]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "odd.stl"], "there are no segmentation weights for 'odd': train them with scripts/generate_scenes"),
        (["--weights", "nowhere.safetensors"], "nowhere.safetensors"),
        (["--method", "euclidean", "--part", "teapot"], "part must be one of part_a"),
        (["--method", "euclidean", "--count", "0"], "count and workers must be at least 1, got 0 and 2"),
        (["--method", "euclidean", "--radius", "0"], "radius must be positive, got 0.0"),
        (["--ablation", "--seed", "0"], "the training scenes are those of seed 0, which are judged; choose another"),
    ],
)
def test_evaluate_segmentation_says_a_users_mistake_in_one_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    evaluate = load("evaluate_segmentation.py")
    out = ["--out", str(tmp_path / "out")]
    assert evaluate.main(evaluate.tyro.cli(evaluate.Arguments, args=[*arguments, *out])) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not (tmp_path / "out").exists()


def test_evaluate_segmentation_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluate = load("evaluate_segmentation.py")

    def stop(*_: object, **__: object) -> Iterator[int]:
        yield 0
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate, "evaluate_scenes", stop)
    assert evaluate.main(evaluate.Arguments(method="euclidean", out=tmp_path)) == 130
    assert f"what is finished is kept in {tmp_path}: the same command goes on" in capsys.readouterr().err

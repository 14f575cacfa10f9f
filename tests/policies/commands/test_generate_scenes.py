import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from binpick_env.cell.settle import SettleError
from binpick_env.config import CameraConfig
from binpick_env.jobs.process_map import WorkerError
from binpick_env.scenes import synthesis
from binpick_env.scenes.synthesis import SceneConfig, ensure_folder_config
from perception.segmentation.scene import BoundaryScene
from policies.commands import generate_scenes as generate
from tests.policies.commands.command_calls import run

SCENES = ["--min-parts", "2", "--max-parts", "3", "--width", "320", "--height", "240", "--sensor", "none"]


@pytest.mark.slow
def test_generate_scenes_makes_resumes_and_refuses_another_configuration(tmp_path: Path) -> None:
    out, facts = tmp_path / "scenes", tmp_path / "new" / "facts.json"
    common = [*SCENES, "--out", str(out)]
    done = run("generate-scenes", "--count", "2", "--workers", "1", "--json", str(facts), *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"2 scenes in {out}" in done.stdout
    numbers = json.loads(facts.read_text())
    assert (numbers["out"], numbers["count"]) == (str(out), 2)
    assert numbers["seconds"] > 0
    made = (out / "scene_00000.npz").stat().st_mtime_ns
    done = run("generate-scenes", "--count", "3", "--workers", "1", *common, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (out / "scene_00000.npz").stat().st_mtime_ns == made
    scenes = [BoundaryScene.load(path) for path in sorted(out.glob("scene_*.npz"))]
    assert len(scenes) == 3
    assert all(scene.part == "tee" and len(scene.T_cam_parts) in (2, 3) for scene in scenes)
    assert all(scene.K[0, 0] == pytest.approx(600.0) for scene in scenes)


def test_generate_scenes_without_a_folder_names_one_after_part_and_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(synthesis, "generate_scenes", lambda *arguments: asked.append(arguments) or iter([0]))
    args = ["--part", "part_b", "--seed", "3", "--count", "1", "--sensor", "mixed", "--no-jitter", "--workers", "4"]
    assert generate.main([*args, *SCENES[:-2]]) == 0
    assert "1 scene in runs/scenes-part_b-3" in capsys.readouterr().out
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
    arguments = [argument.format(claimed=tmp_path) for argument in arguments]
    out = [] if "--out" in arguments else ["--out", str(tmp_path / "out")]
    assert generate.main([*arguments, *out]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("fault", "code", "message"),
    [
        (KeyboardInterrupt(), 130, "finished scenes are kept in {out}: the same command resumes there"),
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
    def stop(*_: object) -> Iterator[int]:
        yield 0
        raise fault

    monkeypatch.setattr(synthesis, "generate_scenes", stop)
    assert generate.run(generate.Arguments(out=tmp_path)) == code
    assert message.format(out=tmp_path) in capsys.readouterr().err

"""`binpick train-segmentation` from scenes to installed weights, alone and in two processes."""

import json
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
import trimesh
from safetensors.torch import load

from binpick_env.cell.settle import SettleError
from binpick_env.parts.families import HELD_OUT_FAMILIES, TRAINING_FAMILIES
from binpick_env.parts.label import part_label
from binpick_env.parts.part import load_part
from binpick_env.scenes import timed_synthesis
from binpick_env.scenes.synthesis import SceneConfig, ensure_folder_config, scene_path
from perception.segmentation import weights as weights_module
from perception.segmentation.scene import SCENES_NOTE
from perception.segmentation.training import run as run_module
from perception.segmentation.training.distributed import Place
from perception.segmentation.training.presets import PRESETS, fine_tuning
from perception.segmentation.training.run import CHECKPOINT, LOG, WEIGHTS, read_log
from perception.segmentation.weights import (
    SHIPPED,
    FoundWeights,
    WeightsError,
    find_weights,
    load_network,
    load_record,
)
from policies.commands import generate_scenes, training_scenes
from policies.commands import train_segmentation as train
from policies.commands.command_line import parse
from policies.commands.train_segmentation import PLOT
from policies.commands.training_scenes import scene_budget, scenes_of_training
from tests.perception.disc_scene import disc_scene
from tests.policies.commands.command_calls import script, start

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the scenes of two parts."""
    runs = tmp_path_factory.mktemp("runs")
    for part in ("bracket", "tee"):
        for k in range(3):
            disc_scene(k, points_each=40).save(runs / f"scenes-{part}-0" / f"scene_{k:05d}.npz")
        (runs / f"scenes-{part}-0" / SCENES_NOTE).write_text(json.dumps({"part": part, "seed": 3}))
    return runs


@pytest.fixture(autouse=True)
def _scenes(tmp_path: Path, scenes: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Go to a folder with scenes of two parts; weights go to a cache of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    shutil.copytree(scenes, tmp_path / "runs")
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def call(*arguments: str) -> int:
    common = ("--batch", "1", "--held-out", "1", "--threads", "1", "--no-tensorboard")
    return train.main([*common, *arguments])


def test_one_network_for_two_parts_is_trained_installed_and_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("--part", "bracket", "tee", "--steps", "2", "--json", "last.json", "--install", "True") == 0
    out = tmp_path / "runs" / "segmentation-shared-ours-0"
    assert {CHECKPOINT, LOG, WEIGHTS} <= {path.name for path in out.iterdir()}
    assert (
        find_weights(load_part("tee").model).path
        == find_weights(load_part("bracket").model).path
        == tmp_path / "cache" / "weights" / "shared.safetensors"
    )
    record = load_record(find_weights(load_part("bracket").model).path)
    assert (record["parts"], record["steps"], record["scenes"]) == (["bracket", "tee"], 2, 4)
    assert [source["scenes"] for source in record["trained_on"]] == [2, 2]
    assert [source["seed"] for source in record["validated_on"]] == [3, 3]
    assert json.loads((tmp_path / "last.json").read_text())["validation"].keys() >= {"ap50", "ap75"}
    assert f"installed {tmp_path / 'cache' / 'weights' / 'shared.safetensors'} " in capsys.readouterr().out
    assert call("--part", "bracket", "tee", "--steps", "2") == 0  # nothing is left to do
    assert "resuming at step 2" in capsys.readouterr().out


def test_the_network_for_every_part_knows_its_families_and_serves_parts_without_their_own(tmp_path: Path) -> None:
    (tmp_path / "runs" / "scenes-bracket-0").rename(tmp_path / "runs" / "scenes-generated-0")
    assert call("--part", "generated", "--steps", "1", "--install", "True") == 0
    installed = tmp_path / "cache" / "weights" / "general.safetensors"
    trained, held_out = (load_part(f"generated:{names[0]}:0").model for names in (TRAINING_FAMILIES, HELD_OUT_FAMILIES))
    assert find_weights(trained) == FoundWeights(path=installed, training="family")
    assert find_weights(held_out) == FoundWeights(path=installed, training="zero-shot")
    assert find_weights(load_part("tee").model).path.name == "shared.safetensors"
    record = load_record(installed)
    assert record["held_out_families"] == [f"generated:{name}" for name in HELD_OUT_FAMILIES]


def test_the_unit_of_a_part_file_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box((2.0, 1.5, 1.0)).export("lid.stl")  # 2 inches, or 2 m
    (tmp_path / "runs" / "scenes-bracket-0").rename(tmp_path / "runs" / f"scenes-{part_label('lid.stl')}-0")
    assert call("--part", "lid.stl", "--steps", "1") == 2
    assert "the unit of lid.stl is unclear" in capsys.readouterr().err
    assert call("--part", "lid.stl", "--steps", "1", "--unit", "inch", "--install", "True") == 0
    part = load_part("lid.stl", unit="inch").model
    assert find_weights(part).training == "own"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "bracket"], "give either steps or minutes"),
        (["--part", "tee", "screw", "--steps", "1"], "runs/scenes-screw-0 holds no scene_*.npz"),
        (["--part", "screw", "--steps", "1"], "screw"),
        (["--part", "tee", "--steps", "1", "--count", "4"], "runs/scenes-tee-0 holds too few scenes"),
        (
            ["--part", "tee", "bracket", "--steps", "1", "--camera-distance", "1.1"],
            "give them to binpick generate-scenes",
        ),
        (["--scenes", "runs/scenes-tee-0", "--steps", "1", "--friction", "1"], "binpick generate-scenes"),
        (["--part", "part_a", "--steps", "1", "--count", "0"], "count must be at least 1, got 0"),
        (["--part", "part_a", "--steps", "1", "--held-out", "-1"], "held_out must not be negative, got -1"),
        (["--part", "part_a", "--minutes", "-1"], "minutes -1.0"),
        (
            ["--part", "bracket", "--steps", "1", "--initial", "nowhere.safetensors"],
            "nowhere.safetensors does not hold a complete",
        ),
        (["--part", "bracket", "--steps", "1", "--learning-rate", "-1"], "learning_rate must be positive, got -1.0"),
        (
            ["--part", "bracket", "--preset", "released", "--steps", "1", "--install", "True"],
            "--preset released cannot be installed, since no command looks for its network",
        ),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*arguments) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line


@pytest.fixture
def drawn_scenes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Replace the synthesis by scenes of discs; return the numbers of scenes that were asked for."""
    asked: list[int] = []

    def generate(config: SceneConfig, count: int, folder: Path, workers: int) -> Iterator[int]:
        asked.append(count)
        ensure_folder_config(config, folder)
        for index in range(count):
            disc_scene(index, points_each=40).save(scene_path(folder, index))
            yield index

    monkeypatch.setattr(timed_synthesis, "generate_scenes", generate)
    return asked


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """Return a list of average precisions, which the next evaluations find."""
    found: list[float] = []
    monkeypatch.setattr(run_module, "validate", lambda *_: dict.fromkeys(("ap", "ap50", "ap75"), found.pop(0)))
    yield found
    assert found == []  # there were as many evaluations


def test_one_part_makes_its_scenes_and_starts_from_the_network_for_every_part(
    tmp_path: Path, drawn_scenes: list[int], judged: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    judged += [0.6, 0.7]
    assert call("--part", "part_a", "--steps", "1", "--count", "4") == 0
    shown = capsys.readouterr().out
    assert "making scenes in runs/scenes-part_a-0, 4 of them" in shown
    assert f"starting from {SHIPPED / 'general.safetensors'}" in shown
    assert "validated AP50 0.700, AP75 0.700, AP 0.700\nat first  AP50 0.600" in shown
    out = tmp_path / "runs" / "segmentation-part_a-ours-0"
    assert [line["step"] for line in read_log(out / LOG)] == [0, 1]
    assert "AP50 0.700" in (out / PLOT).read_text()
    record = load_record(out / WEIGHTS)
    assert (record["scenes"], record["trained_on"][0]["sensor"]) == (3, "all")
    assert record["training"]["learning_rate"] == fine_tuning(PRESETS["ours"]).learning_rate
    assert record["initial"]["parts"] == load_record(SHIPPED / "general.safetensors")["parts"]
    assert record["scene_minutes"] > 0
    assert find_weights(load_part("part_a").model).path == tmp_path / "cache" / "weights" / "part_a.safetensors"
    first = (out / CHECKPOINT).read_bytes()
    judged += [0.7, 0.6, 0.7]
    assert call("--part", "part_a", "--steps", "1", "--count", "4") == 0  # nothing is left to do
    assert call("--part", "part_a", "--steps", "1", "--count", "4", "--out", "again") == 0
    assert drawn_scenes == [4]
    assert_same_tensors(first, Path("again", CHECKPOINT).read_bytes())


def assert_same_tensors(first: bytes, second: bytes) -> None:
    """Fail unless two checkpoints have the same tensors, whatever time they took."""
    one, other = load(first), load(second)
    assert one.keys() == other.keys()
    assert [name for name in one if not torch.equal(one[name], other[name])] == []


def test_minutes_count_scenes_and_training_together(
    drawn_scenes: list[int], judged: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    judged += [0.6, 0.7]
    assert call("--part", "part_a", "--minutes", "0.001") == 0
    assert "0.0 of the 0.001 minutes, but 2 to 1000 of them" in capsys.readouterr().out
    assert drawn_scenes == [1000]
    assert len(list(Path("runs/scenes-part_a-0").glob("scene_*.npz"))) == 2
    args = train.Arguments(part=("part_a",), minutes=9.0)
    assert scene_budget(args).seconds == 3 * 60
    assert args.length(args.config(), 1, scene_minutes=3.1).minutes == pytest.approx(5.9)
    assert args.length(args.config(), 1, scene_minutes=8.0).minutes == 4.5
    assert args.length(args.config(), 1).minutes == 9.0


def test_more_scenes_are_made_where_those_of_an_earlier_training_are_too_few(
    drawn_scenes: list[int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(training_scenes, "MOST", 5)
    monkeypatch.setattr(training_scenes, "COUNT", 6)
    args = train.Arguments(part=("part_a",), held_out=1, out=Path("first"))
    scenes_of_training(replace(args, steps=1, count=2), Place())
    scenes_of_training(replace(args, steps=1, count=3), Place())  # although the first making is finished
    scenes_of_training(replace(args, minutes=9.0, out=Path("longer")), Place())
    scenes_of_training(replace(args, minutes=9.0, out=Path("seed-1")), Place())  # there are enough now
    scenes_of_training(replace(args, steps=1, out=Path("steps")), Place())
    assert drawn_scenes == [2, 3, 5, 6]
    # A training stays on the scenes that it began with, so that it can be resumed.
    for out, count in (("first", 3), ("longer", 5), ("seed-1", 6), ("steps", 6)):
        assert sum(len(paths) for paths in replace(args, out=Path(out)).files()) == count
    assert "made 1 scene besides 5 that were there in 0.0 min" in capsys.readouterr().out


def test_the_scenes_are_made_in_the_bin_and_under_the_camera_that_are_given(
    drawn_scenes: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    place = ("--bin", "400x300x150", "--camera-distance", "1.1", "--friction", "0.3", "--density", "7800")
    args = parse(train.Arguments, "train", ["--part", "part_a", *place, "--steps", "1", "--count", "2"])
    scenes_of_training(args, Place())
    facts = json.loads(Path("runs/scenes-part_a-0", SCENES_NOTE).read_text())
    assert (facts["bin"], facts["camera"]["distance"]) == ([0.4, 0.3, 0.15], 1.1)
    assert (facts["friction"], facts["density"]) == (0.3, 7800.0)
    assert call("--part", "part_a", *place[:-1], "2700", "--steps", "1") == 2
    assert "runs/scenes-part_a-0 holds scenes of another pile or camera" in capsys.readouterr().err


def test_random_weights_get_scenes_too(drawn_scenes: list[int], judged: list[float]) -> None:
    judged += [0.6]
    assert call("--part", "part_a", "--steps", "1", "--count", "4", "--initial", "none") == 0
    assert drawn_scenes == [4]


def test_missing_scenes_of_several_parts_are_told_by_the_command_that_makes_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(tmp_path / "a folder" / "screw.stl")
    assert call("--part", "tee", path, "--unit", "mm", "--steps", "1") == 2
    words = shlex.split(capsys.readouterr().err.split("make them with: ")[1])
    assert words[:2] == ["binpick", "generate-scenes"]
    made = parse(generate_scenes.Arguments, "generate-scenes", words[2:])
    assert (made.part, made.unit, made.out) == (path, "mm", Path("runs") / f"scenes-{part_label(path)}-0")


def test_random_weights_are_advised_where_none_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights_module, "SHIPPED", tmp_path / "nothing")
    with pytest.raises(WeightsError, match=r"no segmentation weights for every part.*; --initial none starts from"):
        train.Arguments(part=("tee",)).start()
    assert train.Arguments(part=("tee",), initial="none").start() is None


def test_missing_weights_are_named_before_scenes_are_made(
    drawn_scenes: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("--part", "part_a", "--steps", "1", "--initial", "nowhere.safetensors") == 2
    assert "nowhere.safetensors does not hold a complete" in capsys.readouterr().err
    assert drawn_scenes == []


def test_scenes_of_a_part_file_in_another_unit_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    trimesh.creation.box((70.0, 30.0, 20.0)).export("lid.stl")  # 79 mm, as the discs
    Path("runs/scenes-bracket-0").rename(f"runs/scenes-{part_label('lid.stl')}-0")
    assert call("--part", "lid.stl", "--steps", "1", "--unit", "mm", "--install", "False") == 0
    assert call("--part", "lid.stl", "--steps", "1", "--unit", "cm", "--install", "False") == 2
    message = "holds scenes of a part of 0.08 m, but the largest diameter of lid.stl is 0.787 m: give the --unit"
    assert message in capsys.readouterr().err


def test_a_pile_that_does_not_settle_says_how_to_make_scenes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def unsettled(*_: Any) -> Iterator[int]:
        raise SettleError("20 parts do not come to rest")
        yield

    monkeypatch.setattr(timed_synthesis, "generate_scenes", unsettled)
    assert call("--part", "part_a", "--steps", "1") == 2
    assert "do not come to rest: make scenes with binpick generate-scenes, --max-parts" in capsys.readouterr().err


def test_a_making_that_was_stopped_goes_on_although_there_are_scenes(
    drawn_scenes: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_scenes, "MOST", 4)
    args, whole = train.Arguments(part=("part_a",), minutes=9.0, held_out=1), timed_synthesis.generate_scenes

    def stopped(*arguments: Any) -> Iterator[int]:
        for index in whole(*arguments):
            if index == 3:
                raise KeyboardInterrupt
            yield index

    with monkeypatch.context() as patch:
        patch.setattr(timed_synthesis, "generate_scenes", stopped)
        with pytest.raises(KeyboardInterrupt):
            scenes_of_training(args, Place())
    first = scenes_of_training(args, Place())
    assert first.done
    assert scenes_of_training(args, Place()) == first
    assert drawn_scenes == [4, 4]
    shutil.rmtree("runs/scenes-part_a-0")
    again = scenes_of_training(args, Place())
    assert (again.done, again.scenes, drawn_scenes) == (True, first.scenes, [4, 4, 4])


@pytest.mark.parametrize(
    ("found", "install", "text"),
    [
        ([0.3, 0.49], None, "not installed: its AP50 on the validation scenes, 0.490, is under 0.5"),
        ([0.3, 0.49], "True", "installed"),
        ([0.8, 0.7], None, "not installed: its AP on the validation scenes, 0.700, is under the 0.800"),
        ([0.8, 0.8], None, "installed"),
        ([0.8, 0.9], "False", None),
    ],
)
def test_poor_networks_are_installed_only_where_that_is_asked_for(
    found: list[float],
    install: str | None,
    text: str | None,
    judged: list[float],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    judged += found
    options = [] if install is None else ["--install", install]
    assert call("--part", "bracket", "--steps", "1", *options) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(text or "at first  AP50 0.800")
    if text is not None and text.startswith("not"):
        assert last.endswith("the same command with --install True installs it all the same")
    assert (tmp_path / "cache" / "weights" / "bracket.safetensors").exists() == (text == "installed")


def test_a_folder_that_weights_cannot_be_installed_in_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "file"))
    assert call("--part", "bracket", "--steps", "1", "--install", "True") == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert message.startswith("error: the weights cannot be installed ")
    assert "they are kept in runs/segmentation-bracket-ours-0/weights.safetensors" in message
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    assert call("--part", "bracket", "--steps", "1", "--install", "True") == 0


def test_random_weights_are_taken_where_that_is_asked_for(
    judged: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    judged += [0.6]  # the random weights are not evaluated
    assert call("--part", "bracket", "--steps", "1", "--initial", "none") == 0
    assert "starting from random weights" in capsys.readouterr().out
    record = load_record(find_weights(load_part("bracket").model).path)
    assert (record["initial"], record["training"]["learning_rate"]) == (None, PRESETS["ours"].learning_rate)


def test_two_processes_train_one_network_and_one_of_them_writes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += [str(script("train-segmentation")), "--part", "bracket", "--steps", "2", "--batch", "1"]
    done = start([*command, "--held-out", "1", "--no-tensorboard"], tmp_path, OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr
    out = tmp_path / "runs" / "segmentation-bracket-ours-0"
    assert [line["step"] for line in read_log(out / LOG)] == [0, 2]
    assert load_record(out / WEIGHTS)["steps"] == 2
    assert load_record(out / WEIGHTS)["epochs"] == 2 * 1 * 2 / 2  # steps x batch x processes / scenes
    load_network(out / WEIGHTS)

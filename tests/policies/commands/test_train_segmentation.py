"""`binpick train-segmentation` from scenes to installed weights, alone and in two processes."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
import trimesh

from binpick_env.parts.families import HELD_OUT_FAMILIES, TRAINING_FAMILIES
from binpick_env.parts.label import part_label
from binpick_env.parts.part import load_part
from perception.segmentation.scene import SCENES_NOTE
from perception.segmentation.training.run import CHECKPOINT, LOG, WEIGHTS
from perception.segmentation.weights import FoundWeights, find_weights, load_network, load_record
from policies.commands import train_segmentation as train
from tests.perception.disc_scene import disc_scene
from tests.policies.commands.command_calls import script, start


@pytest.fixture(autouse=True)
def _scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Go to a folder with scenes of two parts; weights go to a cache of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    for part in ("bracket", "tee"):
        for k in range(3):
            disc_scene(k, points_each=40).save(tmp_path / "runs" / f"scenes-{part}-0" / f"scene_{k:05d}.npz")
        (tmp_path / "runs" / f"scenes-{part}-0" / SCENES_NOTE).write_text(json.dumps({"part": part, "seed": 3}))
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def call(*arguments: str) -> int:
    common = ("--batch", "1", "--held-out", "1", "--threads", "1", "--no-tensorboard")
    return train.main([*common, *arguments])


def test_one_network_for_two_parts_is_trained_installed_and_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("--part", "bracket", "tee", "--steps", "2", "--json", "last.json") == 0
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
    assert "installed" in capsys.readouterr().out
    assert call("--part", "bracket", "tee", "--steps", "2") == 0  # nothing is left to do
    assert "resuming at step 2" in capsys.readouterr().out


def test_the_network_for_every_part_knows_its_families_and_serves_parts_without_their_own(tmp_path: Path) -> None:
    (tmp_path / "runs" / "scenes-bracket-0").rename(tmp_path / "runs" / "scenes-generated-0")
    assert call("--part", "generated", "--steps", "1") == 0
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
    assert call("--part", "lid.stl", "--steps", "1", "--unit", "inch") == 0
    part = load_part("lid.stl", unit="inch").model
    assert find_weights(part).training == "own"


def test_the_papers_preset_trains_200_epochs_unless_told_otherwise() -> None:
    args = train.Arguments(part=("bracket",), preset="paper")
    assert args.length(args.config(), 1000).steps == 100_000
    assert args.length(args.config(), 1000, world=4).steps == 25_000
    assert train.Arguments(preset="paper", steps=7).length(args.config(), 1000).steps == 7


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--part", "bracket"], "give either steps or minutes"),
        (["--part", "screw", "--steps", "1"], "runs/scenes-screw-0 holds no scene_*.npz"),
        (
            ["--part", "bracket", "--steps", "1", "--initial", "nowhere.safetensors"],
            "nowhere.safetensors does not hold a complete",
        ),
        (["--part", "bracket", "--steps", "1", "--learning-rate", "-1"], "learning_rate must be positive, got -1.0"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*arguments) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line


@pytest.mark.slow
def test_two_processes_train_one_network_and_one_of_them_writes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += [str(script("train-segmentation")), "--part", "bracket", "--steps", "2", "--batch", "1"]
    done = start([*command, "--held-out", "1", "--no-tensorboard"], tmp_path, OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr
    out = tmp_path / "runs" / "segmentation-bracket-ours-0"
    assert len((out / LOG).read_text().splitlines()) == 1
    assert load_record(out / WEIGHTS)["steps"] == 2
    assert load_record(out / WEIGHTS)["epochs"] == 2 * 1 * 2 / 2  # steps x batch x processes / scenes
    load_network(out / WEIGHTS)

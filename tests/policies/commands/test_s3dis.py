"""`binpick s3dis` from synthetic rooms to the table."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from binpick_env.jobs import node, process_map
from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Cluster, WorkerError
from perception.runtime.file_work import Run
from perception.s3dis.data import raw_tree
from perception.s3dis.data.categories import SCORED
from perception.s3dis.data.dataset import BlockBatches
from perception.s3dis.data.room import find_rooms, room_path
from perception.s3dis.evaluation import table
from perception.s3dis.evaluation.identities import ground_truth
from perception.s3dis.evaluation.subject import Subject
from perception.s3dis.predictor import RoomPredictor
from perception.s3dis.presets import ROWS
from perception.s3dis.scoring import S3disScores, match_rooms
from perception.segmentation.training import distributed
from perception.segmentation.training.distributed import Place
from perception.segmentation.weights import load_network, load_record
from policies.commands import s3dis, s3dis_table
from tests.binpick_env.jobs.node_map import distant_node, node_map
from tests.binpick_env.jobs.pickled_map import pickled_map
from tests.perception.s3dis.s3dis_tree import LINES, told_by_colour_room, write_tree


def call(*arguments: object) -> int:
    return s3dis.main([str(argument) for argument in arguments])


@pytest.mark.slow
def test_synthesize_prepare_and_both_identities(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    raw, rooms = tmp_path / "raw", tmp_path / "rooms"
    made = ("synthesize", "--out", raw, "--rooms", 3, "--seed", 31, "--density", 150, "--workers", 1)
    assert call(*made) == 0
    assert call(*made) == 0
    assert f"3 rooms in {raw}" in capsys.readouterr().out
    prepared = ("prepare", "--raw", raw, "--out", rooms, "--workers", 2, "--json", tmp_path / "made.json")
    with monkeypatch.context() as patch:
        patch.setattr(process_map, "map_indices", pickled_map)
        assert call(*prepared) == 0
    first = json.loads((tmp_path / "made.json").read_text())
    assert (first["rooms"], first["new"], first["remarks"]) == (3, 3, [])
    assert call(*prepared) == 0
    assert json.loads((tmp_path / "made.json").read_text())["new"] == 0
    capsys.readouterr()
    for predictions, least in (("ground_truth", 1.0), ("merged_ground_truth_blocks", 0.99)):
        out = tmp_path / f"{predictions}.json"
        judged = ("evaluate", "--rooms", rooms, "--predictions", predictions, "--workers", 1, "--json", out)
        assert call(*judged) == 0
        found = json.loads(out.read_text())
        assert tuple(found["ap50"]) == SCORED
        assert min(found["mean_ap50"], found["ap25"]) >= least
        assert {value for value in found["ap50"].values() if value is not None} == {1.0} or least < 1
        assert {"ap", "rooms", "population", "git_commit", "versions"} <= found.keys()
        table = capsys.readouterr().out
        assert "SGPN (PointNet, colour)" in table
        assert predictions in table
    assert call("evaluate", "--rooms", rooms, "--predictions", "ground_truth", "--population", "blocks") == 0
    assert "blocks" not in capsys.readouterr().err


def test_remarks_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_tree(tmp_path / "raw", {"Area_1/office_1/stairs_1": LINES})
    assert call("prepare", "--raw", tmp_path / "raw", "--out", tmp_path / "out") == 0
    assert "stairs_1.txt: stairs read as clutter\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["prepare", "--raw", "broken", "--out", "out"], "office_2/Annotations/wall_1.txt, line 3 holds not 6 numbers"),
        (["prepare", "--raw", "broken", "--out", "out", "--workers", "1"], "wall_1.txt, line 3 holds not 6 numbers"),
        (["prepare", "--raw", "nowhere", "--out", "out"], "nowhere is no folder"),
        (["prepare", "--raw", "broken", "--out", "out", "--workers", "0"], "workers must be at least 1, got 0"),
        (["synthesize", "--out", "out", "--rooms", "0"], "rooms must be at least 1, got 0"),
        (["synthesize", "--out", "out", "--density", "-1"], "density must be positive"),
        (["train", "--rooms", "nowhere", "--steps", "1"], "nowhere holds no room of area 1, 2, 3, 4, 6"),
        (["evaluate", "--rooms", "nowhere", "--weights", "lost"], "nowhere holds no room of area 5"),
        (["evaluate", "--rooms", "nowhere", "--predictions", "ground_truth"], "nowhere holds no room of area 1, 2"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_tree(tmp_path / "broken", {"Area_1/office_1/wall_1": LINES, "Area_1/office_2/wall_1": LINES + "1 2 3\n"})
    if "--workers" not in arguments:
        monkeypatch.setattr(process_map, "map_indices", pickled_map)
    assert call(*arguments) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert message in line
    assert not list((tmp_path / "out").rglob("*office_2*"))
    assert not list((tmp_path / "out").rglob("rooms.json"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--rooms", "nowhere"], "give either weights or predictions"),
        (["evaluate", "--rooms", "x", "--predictions", "ground_truth", "--weights", "y"], "give either weights or"),
        (["train", "--rooms", "nowhere", "--held-out", "-1"], "held_out must be 0 or more, got -1"),
    ],
)
def test_arguments_that_do_not_go_together_are_named(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*arguments) == 2
    assert message in capsys.readouterr().err


def test_a_tree_of_another_seed_is_not_mixed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = ("synthesize", "--out", tmp_path, "--rooms", 1, "--density", 20, "--workers", 1)
    assert call(*common, "--seed", 31) == 0
    assert call(*common, "--seed", 32) == 2
    assert "seed: 31 there, 32 here" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["synthesize", "--out", "out", "--rooms", "1"],
        ["prepare", "--raw", "raw", "--out", "out"],
        ["evaluate", "--rooms", "rooms", "--weights", "weights.safetensors"],
        ["s3dis-table", "--rooms", "rooms", "--steps", "1"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_rooms_are_computed_on_clusters(
    arguments: list[str], small_rooms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_tree(tmp_path / "raw", {"Area_1/office_1/chair_1": LINES})
    places: list[Any] = []

    def lost(work: Any, indices: Any, workers: Any) -> Iterator[Any]:
        places.append(workers)
        raise WorkerError("the cluster is lost")
        yield

    def predict(self: Any, device: str) -> Any:
        assert device == "cpu"  # also where this machine has a GPU

    monkeypatch.setattr(process_map, "map_indices", lost)
    monkeypatch.setattr(s3dis, "_device", lambda: "cuda")
    monkeypatch.setattr(Subject, "predict", predict)
    command = s3dis_table.main if arguments[0] == "s3dis-table" else s3dis.main
    given = arguments[1:] if arguments[0] == "s3dis-table" else arguments
    assert command([*given, "--workers", "3", "--cluster", "local"]) == 2
    assert places == [Cluster(address="local", workers=3)]


def test_ctrl_c_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(raw_tree, "find_raw_rooms", interrupted)
    assert call("prepare", "--raw", tmp_path, "--out", tmp_path) == 130
    assert "the same command resumes there" in capsys.readouterr().err


@pytest.fixture
def small_rooms(tmp_path: Path) -> Path:
    """Return a folder of six rooms of cubes, one of an area."""
    for area in range(1, 7):
        room = told_by_colour_room(area, f"Area_{area}/office_1", points=150)
        room.save(room_path(tmp_path / "rooms", room.name))
    return tmp_path / "rooms"


@pytest.mark.slow
def test_train_and_evaluate_print_table_1_with_our_row(
    small_rooms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    train = ("train", "--rooms", small_rooms, "--row", "dgcnn-new", "--budget", "small", "--out", out, "--seed", 3)
    train += ("--points", 64, "--batch", 2, "--held-out", 1, "--threads", 1)
    assert call(*train, "--steps", 2) == 0
    assert str(out / "weights.safetensors") in capsys.readouterr().out
    assert call(*train, "--steps", 2) == 0  # nothing is left to do
    assert call(*train, "--steps", 3) == 2
    assert "belongs to another training (steps: 2 there, 3 here)" in capsys.readouterr().err
    judged = ("evaluate", "--rooms", small_rooms, "--weights", out / "weights.safetensors", "--json", tmp_path / "e")
    assert call(*judged, "--workers", 2) == 0
    table = capsys.readouterr().out
    assert "last row: 1 room of" in table  # of Area 5 alone
    assert [line.split("  ")[0] for line in table.splitlines() if "  " in line][1:6] == [
        "SGPN (PointNet, colour)", "paper (DGCNN, colour)", "paper (DGCNN, new loss)",
        "paper (DGCNN, colour, new loss)", "dgcnn-new",
    ]  # fmt: skip
    found = json.loads((tmp_path / "e").read_text())
    assert {"ap50", "mean_ap50", "ap25", "ap"} <= found.keys()
    assert (found["training"]["row"], found["training"]["steps"]) == ("dgcnn-new", 2)
    assert call(*judged, "--workers", 1, "--areas", 1, 2, "--threshold", 5.0, "--population", "blocks") == 0
    assert "last row: 2 rooms" in capsys.readouterr().out


def test_the_table_trains_every_row_and_is_not_mixed_with_another(
    small_rooms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rows are truly trained by the page on rooms, whose lines tests/test_shell_lines.py runs."""
    trained: list[tuple[str, int]] = []

    class Truth:
        @staticmethod
        def from_file(_: Path) -> Any:
            return lambda room, _: ground_truth(room)

    monkeypatch.setattr(table, "train_row", lambda training: trained.append((training.row, training.points)))
    monkeypatch.setattr(table, "RoomPredictor", Truth)
    monkeypatch.setattr(process_map, "map_indices", pickled_map)
    out = tmp_path / "table"

    def make(*arguments: object) -> int:
        given = ["--rooms", small_rooms, "--out", out, "--points", 64, "--batch", 2, "--held-out", 1, *arguments]
        return s3dis_table.main([str(argument) for argument in given])

    for _ in range(2):
        assert make("--steps", 1, "--seeds", 1, "--workers", 2, "--json", tmp_path / "t.json") == 0
        text = capsys.readouterr().out
        for row in ("SGPN (PointNet, colour)", *ROWS, "gain on sgpn-colour"):
            assert row in text
        assert [row["row"] for row in json.loads((tmp_path / "t.json").read_text())["rows"]] == list(ROWS)
        assert sorted(trained) == sorted((row, 64) for row in ROWS)  # each once
    assert make("--steps", 2, "--seeds", 1) == 2
    assert "holds trainings of another configuration" in capsys.readouterr().err


@pytest.mark.slow
def test_a_training_on_a_node_is_the_one_made_here(
    small_rooms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(node.tempfile, "tempdir", str(tmp_path))
    Path("link").symlink_to("rooms")
    config = table.TableConfig(rooms=Path("link"), steps=1, seeds=1, points=32, batch=2, held_out=1)
    (here,) = table.judge_rows(config, Path("here"), lambda work, indices: map_indices(work, indices[:1], 1))
    on_node: Run[Any] = partial(node_map, cluster=Cluster())
    with distant_node(small_rooms, Path("here")):
        (there,) = table.judge_rows(config, Path("there"), lambda work, indices: on_node(work, indices[:1]))
    assert (there.row, there.names) == (here.row, here.names) == (ROWS[0], ("Area_5/office_1",))
    files = {path.relative_to("here") for path in Path("here").rglob("*") if path.is_file()}
    assert files == {path.relative_to("there") for path in Path("there").rglob("*") if path.is_file()}
    ours, theirs = (Path(name) / f"{ROWS[0]}-0" for name in ("here", "there"))
    assert (ours / "scores.json").read_bytes() == (theirs / "scores.json").read_bytes()
    first, second = (load_record(folder / "weights.safetensors") for folder in (ours, theirs))
    assert first | {"minutes": 0} == second | {"minutes": 0}
    assert first["rooms"] == str(small_rooms.resolve())
    tensors, others = (load_network(folder / "weights.safetensors").state_dict() for folder in (ours, theirs))
    assert all(torch.equal(tensors[name], others[name]) for name in tensors)
    predict = RoomPredictor.from_file(ours / "weights.safetensors")
    with distant_node(small_rooms, Path("here")):
        (matches,) = match_rooms(predict, find_rooms(Path("rooms"), (5,)), on_node)
    assert S3disScores.of([matches]).ap50 == S3disScores.of(here.matches).ap50


@pytest.mark.slow
def test_of_the_processes_that_train_a_row_the_first_writes(
    small_rooms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In test_train_segmentation.py, torchrun starts processes."""
    ranks: list[int] = []
    make = BlockBatches.of

    def made(config: Any, rooms: Any, rank: int) -> BlockBatches:
        ranks.append(rank)
        return make(config, rooms, rank)

    monkeypatch.setattr(BlockBatches, "of", made)
    out = tmp_path / "out"
    for rank, written in ((1, False), (0, True)):

        @contextmanager
        def processes(rank: int = rank) -> Iterator[Place]:
            yield Place(rank=rank, world=2)

        monkeypatch.setattr(distributed, "processes", processes)
        train = ("train", "--rooms", small_rooms, "--row", "sgpn-colour", "--budget", "small", "--out", out)
        assert call(*train, "--steps", 2, "--batch", 2, "--points", 32, "--held-out", 1, "--threads", 1) == 0
        assert out.exists() == written
    assert ranks == [1, 0]
    assert len((out / "log.jsonl").read_text().splitlines()) == 1
    assert load_record(out / "weights.safetensors")["steps"] == 2
    load_network(out / "weights.safetensors")

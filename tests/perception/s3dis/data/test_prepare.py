"""From the raw tree to rooms: resumed, atomic, with a note."""

import json
import logging
from functools import partial
from pathlib import Path

import pytest

from binpick_env.jobs import node
from binpick_env.jobs.workers import Cluster
from perception.runtime.file_work import Run
from perception.s3dis.data.annotation import RawDataError
from perception.s3dis.data.prepare import PreparedRoom, prepare_rooms
from perception.s3dis.data.raw_tree import find_raw_rooms
from perception.s3dis.data.room import ROOMS_NOTE, Room
from tests.binpick_env.jobs.node_map import distant_node, node_map
from tests.perception.s3dis.s3dis_tree import LINES, write_tree

TREE = {
    "Area_1/office_1/chair_1": LINES,
    "Area_1/office_1/chair_2": LINES,
    "Area_2/hallway_1/stairs_1": LINES * 9,
    "Area_5/hallway_6/ceiling_1": LINES + "1.0 2.0 3.0 185\x00187 182\n",
}


def prepare(raw: Path, out: Path) -> dict[str, PreparedRoom]:
    return {room.name: room for room in prepare_rooms(find_raw_rooms(raw), out)}


@pytest.mark.slow
def test_every_room_has_a_file_and_the_folder_a_note(tmp_path: Path) -> None:
    raw, out = write_tree(tmp_path / "raw", TREE), tmp_path / "out"
    done = prepare(raw, out)
    assert list(done) == ["Area_2/hallway_1", "Area_1/office_1", "Area_5/hallway_6"]  # the largest first
    assert done["Area_1/office_1"].objects == {"chair": 2}
    assert (done["Area_1/office_1"].points, done["Area_1/office_1"].new) == (4, True)
    assert len(Room.load(out / "Area_5" / "hallway_6.npz")) == 3
    note = json.loads((out / ROOMS_NOTE).read_text())
    assert note["raw"] == str(raw.resolve())
    assert note["rooms"]["Area_2/hallway_1"] == {"points": 18, "objects": {"clutter": 1}}
    assert note["remarks"] == [
        "Area_2/hallway_1/Annotations/stairs_1.txt: stairs read as clutter",
        "Area_5/hallway_6/Annotations/ceiling_1.txt, line 3: repaired a damaged byte",
    ]
    assert {"versions", "git_commit", "command", "categories"} <= note.keys()


def test_whole_rooms_are_kept_damaged_and_changed_ones_made_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    raw, out = write_tree(tmp_path / "raw", TREE), tmp_path / "out"
    prepare(raw, out)
    note = json.loads((out / ROOMS_NOTE).read_text())
    before = (out / "Area_1" / "office_1.npz").stat().st_mtime_ns
    damaged = out / "Area_5" / "hallway_6.npz"
    damaged.write_bytes(damaged.read_bytes()[:-40])
    write_tree(raw, {"Area_2/hallway_1/door_1": LINES})
    with caplog.at_level(logging.WARNING):
        done = prepare(raw, out)
    assert {name: room.new for name, room in done.items()} == {
        "Area_1/office_1": False,
        "Area_2/hallway_1": True,
        "Area_5/hallway_6": True,
    }
    assert (out / "Area_1" / "office_1.npz").stat().st_mtime_ns == before
    assert "made again" in caplog.text
    assert done["Area_2/hallway_1"].objects == {"door": 1, "clutter": 1}
    assert len(Room.load(damaged)) == 3
    assert json.loads((out / ROOMS_NOTE).read_text())["remarks"] == note["remarks"]  # those of kept rooms stay


def test_a_malformed_member_leaves_nothing_half_written(tmp_path: Path) -> None:
    raw, out = write_tree(tmp_path / "raw", {**TREE, "Area_1/office_1/wall_1": LINES + "1 2 3 4 5\n"}), tmp_path / "out"
    with pytest.raises(RawDataError, match=r"Area_1/office_1/Annotations/wall_1\.txt, line 3 holds not 6 numbers"):
        prepare(raw, out)
    left = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
    assert left == ["Area_2/hallway_1.npz"]  # finished before; no office, no note, no draft
    write_tree(raw, {"Area_1/office_1/wall_1": LINES})
    assert not prepare(raw, out)["Area_2/hallway_1"].new


def test_a_node_makes_a_room_of_files_that_it_does_not_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = write_tree(tmp_path / "raw", TREE)
    monkeypatch.setattr(node.tempfile, "tempdir", str(tmp_path))
    on_node: Run[PreparedRoom] = partial(node_map, cluster=Cluster())
    here, there = prepare(raw, tmp_path / "here"), tmp_path / "there"
    with distant_node(raw):
        assert {room.name: room for room in prepare_rooms(find_raw_rooms(raw), there, on_node)} == here
        assert not any(room.new for room in prepare_rooms(find_raw_rooms(raw), there, on_node))
        for name in here:
            assert (there / f"{name}.npz").read_bytes() == (tmp_path / "here" / f"{name}.npz").read_bytes()
        write_tree(raw, {"Area_1/office_1/wall_1": "1 2 3\n"})
        with pytest.raises(RawDataError, match=rf"^{raw}/Area_1/office_1/Annotations/wall_1\.txt, line 1 holds not 6"):
            list(prepare_rooms(find_raw_rooms(raw), there, on_node))


def test_the_same_tree_gives_the_same_bytes(tmp_path: Path) -> None:
    raw = write_tree(tmp_path / "raw", TREE)
    for name in ("a", "b"):
        prepare(raw, tmp_path / name)
    first, second = (Room.load(tmp_path / name / "Area_1" / "office_1.npz") for name in ("a", "b"))
    assert first.xyz.tobytes() == second.xyz.tobytes()
    assert first.source == second.source

"""A room and its file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.s3dis.data import room as module
from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.room import Room, RoomError, area_of, find_rooms, mean_sizes, room_path
from tests.perception.s3dis.s3dis_tree import boxes_room

ROOM = boxes_room([("wall", (0, 0, 0)), ("chair", (1, 0, 0)), ("chair", (2, 0, 0))], points=5)


def test_a_room_comes_back_as_it_was(tmp_path: Path) -> None:
    room = replace(ROOM, source="abc", remarks=("one", "two"))
    path = room_path(tmp_path, room.name)
    assert path == tmp_path / "Area_5" / "office_1.npz"
    room.save(path)
    again = Room.load(path)
    for name in ("xyz", "rgb", "semantic", "instance"):
        before, after = getattr(room, name), getattr(again, name)
        assert before.dtype == after.dtype
        np.testing.assert_array_equal(before, after)
    assert (again.name, again.source, again.remarks, again.area, len(again)) == (
        room.name,
        "abc",
        ("one", "two"),
        5,
        15,
    )


@pytest.mark.parametrize("at", [0.1, 0.5, 0.9])
def test_a_damaged_file_is_no_room(tmp_path: Path, at: float) -> None:
    path = tmp_path / "room.npz"
    boxes_room([("wall", (0, 0, 0))], points=500).save(path)
    whole = path.read_bytes()
    k = int(len(whole) * at)
    path.write_bytes(whole[:k])
    with pytest.raises(RoomError, match=r"room\.npz does not hold a complete room"):
        Room.load(path)
    path.write_bytes(whole[:k] + bytes([whole[k] ^ 0xFF]) + whole[k + 1 :])
    with pytest.raises(RoomError, match=r"room\.npz does not hold a complete room"):
        Room.load(path)


def test_a_room_of_another_version_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ROOM.save(tmp_path / "room.npz")
    monkeypatch.setattr(module, "FORMAT", replace(module.FORMAT, version=2))
    with pytest.raises(RoomError, match="is a room of version 1, this code reads 2; s3dis prepare makes rooms"):
        Room.load(tmp_path / "room.npz")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "office_1"}, "name must be Area_NUMBER/ROOM, got 'office_1'"),
        ({"xyz": ROOM.xyz[:, :2]}, r"xyz must be \(N, 3\)"),
        ({"rgb": ROOM.rgb[1:]}, r"rgb must be \(15, 3\), got \(14, 3\)"),
        ({"semantic": ROOM.semantic[1:]}, r"semantic must be \(15,\), got \(14,\)"),
        ({"semantic": ROOM.semantic.astype(np.int64)}, "semantic must be uint8, got int64"),
        ({"instance": ROOM.instance.astype(np.uint8)}, "instance must be int32, got uint8"),
        ({"instance": ROOM.instance - 1}, "semantic must be below 13 and instance not negative, got 8 and -1"),
        (
            {"semantic": ROOM.semantic + np.uint8(9)},
            "semantic must be below 13 and instance not negative, got 17 and 0",
        ),
        ({name: getattr(ROOM, name)[:0] for name in ("xyz", "rgb", "semantic", "instance")}, "has no points"),
    ],
)
def test_nonsense_is_rejected(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(ROOM, **changes)  # type: ignore[arg-type]


def test_the_area_is_in_the_name() -> None:
    assert area_of("Area_6/hallway_12") == 6
    with pytest.raises(ValueError, match="name must be Area_NUMBER/ROOM, got 'Area_x/hallway'"):
        area_of("Area_x/hallway")


def test_rooms_are_found_by_area(tmp_path: Path) -> None:
    for name in ("Area_5/office_2", "Area_5/office_1", "Area_1/hallway_1"):
        replace(ROOM, name=name).save(room_path(tmp_path, name))
    (tmp_path / "Area_5" / ".office_3.npz.17").write_text("a draft")
    found = [f"{path.parent.name}/{path.stem}" for path in find_rooms(tmp_path)]
    assert found == ["Area_1/hallway_1", "Area_5/office_1", "Area_5/office_2"]
    assert [path.stem for path in find_rooms(tmp_path, [5])] == ["office_1", "office_2"]
    with pytest.raises(FileNotFoundError, match=r"holds no room of area 2, 3; make some with s3dis\.py prepare"):
        find_rooms(tmp_path, [2, 3])


def test_mean_sizes_by_hand() -> None:
    other = boxes_room([("chair", (0, 0, 0))], points=20)
    sizes = mean_sizes([ROOM, other])
    expected = np.zeros(len(CATEGORIES))
    expected[CATEGORIES.index("wall")], expected[CATEGORIES.index("chair")] = 5, (5 + 5 + 20) / 3
    np.testing.assert_allclose(sizes, expected)


def test_an_id_that_no_point_carries_is_no_object() -> None:
    room = replace(ROOM, instance=np.where(ROOM.instance == 1, np.int32(7), ROOM.instance).astype(np.int32))
    assert room.category_of_instance()[[0, 7, 2]].tolist() == [2, 8, 8]
    assert mean_sizes([room])[CATEGORIES.index("ceiling")] == 0

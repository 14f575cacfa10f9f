"""The folder tree: what is a room, what is a member, and what is neither."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.s3dis.data.annotation import RawDataError
from perception.s3dis.data.categories import CATEGORIES
from perception.s3dis.data.raw_tree import find_raw_rooms
from tests.perception.s3dis.s3dis_tree import LINES, write_tree

THREE = "1 1 1 1 1 1\n" * 3


def test_a_member_is_an_object_and_id_0_is_one_too(tmp_path: Path) -> None:
    members = {"Area_1/office_1/chair_2": LINES, "Area_1/office_1/board_1": THREE, "Area_1/office_1/chair_10": LINES}
    (raw,) = find_raw_rooms(write_tree(tmp_path, members))
    assert raw.members == ("board_1.txt", "chair_10.txt", "chair_2.txt")
    room = raw.read()
    assert room.name == "Area_1/office_1"
    np.testing.assert_array_equal(room.instance, [0, 0, 0, 1, 1, 2, 2])
    assert room.instance.dtype == np.int32
    board, chair = CATEGORIES.index("board"), CATEGORIES.index("chair")
    np.testing.assert_array_equal(room.semantic, [board] * 3 + [chair] * 4)
    np.testing.assert_array_equal(room.xyz[3], np.array([1.5, -2.25, 0.125], np.float32))
    assert room.remarks == ()


def test_more_than_256_objects_keep_their_ids(tmp_path: Path) -> None:
    (raw,) = find_raw_rooms(write_tree(tmp_path, {f"Area_1/office_1/chair_{k}": LINES for k in range(300)}))
    assert np.unique(raw.read().instance).tolist() == list(range(300))


def test_rooms_of_all_areas_in_order_and_nothing_else(tmp_path: Path) -> None:
    names = [f"{area}/{room}" for area in ("Area_1", "Area_2") for room in ("hallway_1", "office_1")]
    write_tree(tmp_path, {f"{name}/wall_1": LINES for name in reversed(names)})
    write_tree(tmp_path, {"Area_1/.office_9.123/wall_1": LINES, "Other/office_1/wall_1": LINES})
    (tmp_path / "Area_1" / "Area_1_alignmentAngle.txt").write_text("office_1 90")
    (tmp_path / "Area_1" / "office_1" / "office_1.txt").write_text("the room's points once more, not read")
    for stray in (".DS_Store", "._wall_1.txt", "Icon"):
        (tmp_path / "Area_1" / "office_1" / "Annotations" / stray).write_text("nothing")
    assert [room.name for room in find_raw_rooms(tmp_path)] == names


def test_stairs_are_clutter_and_reported(tmp_path: Path) -> None:
    (raw,) = find_raw_rooms(write_tree(tmp_path, {"Area_1/office_1/stairs_1": LINES}))
    room = raw.read()
    assert set(room.semantic.tolist()) == {CATEGORIES.index("clutter")}
    assert room.remarks == ("Area_1/office_1/Annotations/stairs_1.txt: stairs read as clutter",)


def test_the_known_second_copy_is_left_out_and_reported(tmp_path: Path) -> None:
    tree = write_tree(tmp_path, {"Area_5/office_36/wall_3": LINES, "Area_5/office_36/wall_3 (1)": LINES})
    room = find_raw_rooms(tree)[0].read()
    assert len(room) == 2
    assert room.remarks == ("Area_5/office_36/Annotations/wall_3 (1).txt: left out, a second copy",)


def test_the_known_fault_is_repaired_by_its_place_in_the_tree(tmp_path: Path) -> None:
    text = LINES + "1.0 2.0 3.0 185\x00187 182\n"
    tree = write_tree(tmp_path, {"Area_5/hallway_6/ceiling_1": text})
    room = find_raw_rooms(tree)[0].read()
    assert room.rgb[2].tolist() == [185, 187, 182]
    assert room.remarks == ("Area_5/hallway_6/Annotations/ceiling_1.txt, line 3: repaired a damaged byte",)
    other = write_tree(tmp_path / "other", {"Area_5/hallway_5/ceiling_1": text})
    with pytest.raises(RawDataError, match=r"hallway_5/Annotations/ceiling_1\.txt, line 3 holds"):
        find_raw_rooms(other)[0].read()


def test_the_digest_covers_names_categories_and_sizes(tmp_path: Path) -> None:
    tree = write_tree(tmp_path / "a", {"Area_1/office_1/chair_1": LINES})
    (raw,) = find_raw_rooms(tree)
    before = raw.digest()
    assert find_raw_rooms(tree)[0].digest() == before
    write_tree(tree, {"Area_1/office_1/chair_1": LINES + THREE})
    assert find_raw_rooms(tree)[0].digest() != before
    for other in ("chair_2", "table_1"):  # of the same size
        (renamed,) = find_raw_rooms(write_tree(tmp_path / other, {f"Area_1/office_1/{other}": LINES}))
        assert renamed.sizes == raw.sizes
        assert renamed.digest() != before
    assert replace(raw, categories=(CATEGORIES.index("table"),)).digest() != before


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"Area_1/office_1/wall": LINES}, r"wall\.txt: a member must be called CATEGORY_NUMBER\.txt"),
        ({"Area_1/office_1/wall_3 (1)": LINES}, r"wall_3 \(1\)\.txt: a member must be called CATEGORY_NUMBER\.txt"),
        ({"Area_1/office_1/lamp_1": LINES}, r"lamp_1\.txt: 'lamp' is none of ceiling, .*, clutter, stairs"),
        ({"Annex/office_1/wall_1": LINES}, r"holds no Area_\*/ROOM folders; it must be the folder that Area_1 is in"),
    ],
)
def test_what_is_no_member_is_named(tmp_path: Path, members: dict[str, str], message: str) -> None:
    with pytest.raises(RawDataError, match=message):
        find_raw_rooms(write_tree(tmp_path, members))


def test_a_room_without_annotations_is_named(tmp_path: Path) -> None:
    write_tree(tmp_path, {"Area_1/office_1/wall_1": LINES})
    (tmp_path / "Area_1" / "office_2").mkdir()
    with pytest.raises(RawDataError, match=r"office_2 holds no Annotations/\*\.txt"):
        find_raw_rooms(tmp_path)

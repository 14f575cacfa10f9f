"""AP over the twelve categories: identities, cases by hand, the paper's table."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.instance import Instance
from perception.s3dis.data.blocks import BlockConfig, cover_room
from perception.s3dis.data.categories import CATEGORIES, SCORED
from perception.s3dis.data.room import Room, RoomError, room_path
from perception.s3dis.evaluation.identities import (
    ground_truth,
    merged_ground_truth_blocks,
    predict_ground_truth,
    predict_merged_ground_truth_blocks,
)
from perception.s3dis.evaluation.published import TABLE_1, table_rows
from perception.s3dis.merging import MergeConfig
from perception.s3dis.scoring import (
    Population,
    S3disScores,
    match_room,
    match_rooms,
    repeated,
    room_rng,
    room_truth,
)
from tests.perception.s3dis.s3dis_tree import boxes_room

THINGS = [("wall", (0, 0, 0)), ("chair", (1, 0, 0)), ("chair", (2, 0, 0)), ("clutter", (0, 1, 0)), ("table", (1, 1, 0))]
ROOM = boxes_room(THINGS)  # type: ignore[arg-type]


def scores(room: Room, instances: list[Instance], population: Population = "room") -> S3disScores:
    return S3disScores.of([match_room(lambda *_: instances, room, population)])


@pytest.mark.parametrize("population", ["room", "blocks"])
@pytest.mark.parametrize("predict", [predict_ground_truth, predict_merged_ground_truth_blocks])
def test_the_truth_scores_exactly_1_in_every_category_present(predict, population: Population) -> None:  # type: ignore[no-untyped-def]
    found = S3disScores.of([match_room(predict, ROOM, population)])
    present = {name: value for name, value in found.ap50.items() if not np.isnan(value)}
    assert present == {"wall": 1.0, "chair": 1.0, "table": 1.0}
    assert (found.mean_ap50, found.ap25, found.ap) == (1.0, 1.0, 1.0)
    assert tuple(found.ap50) == SCORED


def test_nothing_scores_0() -> None:
    found = scores(ROOM, [])
    assert (found.mean_ap50, found.ap25, found.ap) == (0.0, 0.0, 0.0)


def test_another_category_scores_0_there() -> None:
    swapped = [replace(i, label=CATEGORIES.index("sofa")) if i.label == 8 else i for i in ground_truth(ROOM)]
    found = scores(ROOM, swapped)
    assert found.ap50["chair"] == 0
    assert np.isnan(found.ap50["sofa"])  # nothing to find: not 0, and not in the mean
    assert found.mean_ap50 == pytest.approx(2 / 3)


def test_a_chair_found_on_clutter_is_wrong_and_clutter_itself_is_not_scored() -> None:
    truth = ground_truth(ROOM)
    clutter = next(i for i in truth if i.label == CATEGORIES.index("clutter"))
    assert scores(ROOM, [i for i in truth if i is not clutter]).mean_ap50 == 1
    wrong = scores(ROOM, [*truth, replace(clutter, label=CATEGORIES.index("chair"))])
    assert wrong.ap50["chair"] == pytest.approx((1 + 2 / 3) / 2)  # precision 1 at recall 0, 2/3 at recall 1


def test_ap25_and_ap_are_at_their_overlaps_by_hand() -> None:
    """A wall found to two fifths is right at .25 only; to seven tenths, at .50 to .65 too, not at .70."""
    wall = ground_truth(ROOM)[0]
    alone = boxes_room([("wall", (0, 0, 0))], points=300)
    for share, expected in ((0.4, (0.0, 1.0, 0.0)), (0.7, (1.0, 1.0, 4 / 9))):
        part = replace(wall, point_idx=np.arange(round(300 * share)))
        found = scores(alone, [part])
        assert (found.mean_ap50, found.ap25, found.ap) == pytest.approx(expected)


def test_objects_under_100_points_need_not_be_found() -> None:
    small = boxes_room([("wall", (0, 0, 0)), ("sofa", (1, 0, 0))], points=99)
    found = scores(small, ground_truth(small))
    assert np.isnan(found.mean_ap50)
    assert all(np.isnan(value) for value in found.ap50.values())


def test_id_0_and_ids_over_255_are_found() -> None:
    places = [("chair", (float(k % 20), float(k // 20), 0.0)) for k in range(300)]
    many = boxes_room(places, points=100)
    truth = ground_truth(many)
    assert len(truth) == 300
    assert scores(many, truth).ap50["chair"] == 1.0
    assert scores(many, truth[1:]).ap50["chair"] < 1.0


def test_rooms_are_pooled_and_not_averaged() -> None:
    one, two = boxes_room([("chair", (0, 0, 0))]), boxes_room([("chair", (0, 0, 0)), ("chair", (1, 0, 0))])
    matches = [match_room(predict_ground_truth, one), match_room(lambda *_: [], two)]
    assert S3disScores.of(matches).ap50["chair"] == pytest.approx(1 / 3)


def test_the_blocks_points_count_as_often_as_they_are_seen() -> None:
    truth = room_truth(ROOM)
    rows = np.array([0, 0, 151, 300])
    half = Instance(point_idx=np.array([0, 300]), score=0.5, label=2)
    again, (found,) = repeated(truth, [half], rows)
    np.testing.assert_array_equal(again.instance_ids, [0, 0, 1, 2])
    np.testing.assert_array_equal(found.point_idx, [0, 1, 3])
    assert (found.score, found.label) == (0.5, 2)


def test_the_population_of_blocks_is_that_of_the_samples() -> None:
    """A wall of which the third that lies in one block only is not found: more of it, where every point counts once."""
    room = boxes_room([("wall", (0, 0, 0))], points=6000)
    rows = np.concatenate([s.point_idx for s in cover_room(room.xyz, BlockConfig(), room_rng(room.name, 0))])
    assert len(rows) == 2 * 4096  # filled up
    part = Instance(point_idx=np.flatnonzero(np.bincount(rows) == 1), score=1.0, label=2)
    share = len(part.point_idx) / 6000
    assert share > 0.5 > len(part.point_idx) / len(rows)
    assert scores(room, [part]).ap50["wall"] == 1.0
    assert scores(room, [part], "blocks").ap50["wall"] == 0.0


def test_populations_have_names() -> None:
    with pytest.raises(ValueError, match="population must be 'room' or 'blocks', got 'points'"):
        match_room(predict_ground_truth, ROOM, "points")  # type: ignore[arg-type]


def test_a_rooms_chance_is_its_own() -> None:
    assert room_rng("Area_1/a", 0).integers(1 << 60) == room_rng("Area_1/a", 0).integers(1 << 60)
    draws = {room_rng(name, seed).integers(1 << 60) for name in ("Area_1/a", "Area_1/b") for seed in (0, 1)}
    assert len(draws) == 4


def test_rooms_are_judged_from_their_files(tmp_path: Path) -> None:
    paths = []
    for k in range(3):
        room = replace(ROOM, name=f"Area_5/office_{k}")
        paths.append(room_path(tmp_path, room.name))
        room.save(paths[-1])
    assert S3disScores.of(list(match_rooms(predict_ground_truth, paths))).mean_ap50 == 1.0
    paths[1].write_bytes(b"PK")
    with pytest.raises(RoomError, match=r"office_1\.npz does not hold a complete room"):
        list(match_rooms(predict_ground_truth, paths))


def test_merging_with_other_constants_arrives() -> None:
    strict = MergeConfig(min_points=10_000)
    assert merged_ground_truth_blocks(ROOM, np.random.default_rng(31), merging=strict) == []
    short = merged_ground_truth_blocks(ROOM, np.random.default_rng(31), BlockConfig(points=64))
    assert len(short) >= len(THINGS)


def test_the_papers_means_are_those_of_its_categories() -> None:
    for row in TABLE_1:
        assert len(row.ap50) == len(SCORED)
        assert np.mean(row.ap50) == pytest.approx(row.mean, abs=0.06)
    assert [row.mean for row in TABLE_1] == [26.4, 27.7, 27.6, 31.2]


def test_a_row_of_ours_stands_under_the_papers_four() -> None:
    found = scores(ROOM, ground_truth(ROOM))
    rows = table_rows([("ours", found)])
    assert rows[0] == ["AP50 [%]", "mean", *SCORED]
    assert rows[1][:3] == ["SGPN (PointNet, colour)", "26.4", "43.6"]
    assert rows[3][0] == "paper (DGCNN, new loss)"
    assert rows[4][-1] == "28.7"
    assert rows[5][:5] == ["ours", "100.0", "–", "–", "100.0"]
    assert {len(row) for row in rows} == {14}

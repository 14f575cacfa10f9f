"""The table of trainings: means over seeds, intervals over rooms, kept verdicts, and what is not done again."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.instance import Instance
from perception.s3dis.data.categories import CATEGORIES, CLUTTER
from perception.s3dis.data.room import Room, room_path
from perception.s3dis.evaluation import table as table_module
from perception.s3dis.evaluation.identities import ground_truth
from perception.s3dis.evaluation.judged import JudgedRow, load_judged, save_judged
from perception.s3dis.evaluation.published import table_rows
from perception.s3dis.evaluation.table import SCORES, TableConfig, interval_lines, judge_rows, tabulate
from perception.s3dis.presets import ROWS
from perception.s3dis.scoring import S3disScores, match_room
from tests.perception.s3dis.s3dis_tree import boxes_room

ROOMS = [
    boxes_room([("chair", (0, 0, 0)), ("table", (1, 0, 0)), ("clutter", (2, 0, 0))], name=f"Area_5/office_{k}")
    for k in range(4)
]


def judged(row: str, seed: int, chairs: int, tables: int) -> JudgedRow:
    """Return verdicts where that many rooms' chairs and tables are found, in the order of the rooms, and no clutter."""

    def found(room: Room) -> list[Instance]:
        k = ROOMS.index(room)
        return [one for one in ground_truth(room)[:2] if k < (chairs, tables)[CATEGORIES[one.label] == "table"]]

    matches = tuple(match_room(lambda room, _: found(room), room) for room in ROOMS)
    return JudgedRow(row=row, seed=seed, names=tuple(room.name for room in ROOMS), matches=matches)


def four(**others: Any) -> list[JudgedRow]:
    return [judged(row, seed, 4, 4) for row in ROWS for seed in range(2) if row not in others]


def test_means_over_seeds_and_intervals_over_rooms() -> None:
    trainings = [judged(ROWS[0], 0, 2, 0), judged(ROWS[0], 1, 4, 0), *four(**{ROWS[0]: None})]
    rows = tabulate(trainings, np.random.default_rng(0), resamples=300)
    assert [row.row for row in rows] == list(ROWS)
    # Chairs of half the rooms, all right: AP = 1/2; of all: 1; no table: 0.
    assert rows[0].seeds == pytest.approx((0.25, 0.5))
    assert rows[0].scores.ap50["chair"] == pytest.approx(0.75)
    assert rows[0].scores.mean_ap50 == pytest.approx(0.375)
    assert np.isnan(rows[0].scores.ap50["sofa"])
    assert 0.25 <= rows[0].interval[0] < 0.375 < rows[0].interval[1] <= 0.5
    assert (rows[0].gain, rows[0].gain_interval) == (0.0, (0.0, 0.0))
    assert rows[3].scores.mean_ap50 == 1.0
    assert rows[3].interval == pytest.approx((1.0, 1.0))
    assert rows[3].gain == pytest.approx(0.625)
    assert rows[3].gain_interval == pytest.approx((1 - rows[0].interval[1], 1 - rows[0].interval[0]))


def test_clutter_counts_for_nothing() -> None:
    mine = judged(ROWS[0], 0, 4, 4)
    assert any(CLUTTER in m.truth_counts for m in mine.matches)
    rows = tabulate([mine, *four(**{ROWS[0]: None})], np.random.default_rng(0), resamples=10)
    assert rows[0].seeds == (1.0,) == (S3disScores.of(mine.matches).mean_ap50,)


def test_the_tables_cells() -> None:
    rows = tabulate([judged(ROWS[0], 0, 2, 0), *four(**{ROWS[0]: None})], np.random.default_rng(0), resamples=50)
    cells = interval_lines(rows)
    assert cells[0][4] == "gain on sgpn-colour"
    assert (cells[1][0], cells[1][1], cells[1][3], cells[1][4]) == ("sgpn-colour", "25.0", "25.0", "+0.0")
    assert (cells[4][0], cells[4][1], cells[4][2], cells[4][3]) == (
        "dgcnn-new-colour", "100.0", "100.0 to 100.0", "100.0 100.0",
    )  # fmt: skip
    assert cells[4][4] == "+75.0"
    assert len({len(row) for row in cells}) == 1
    assert table_rows([(row.row, row.scores) for row in rows])[5][:2] == ["sgpn-colour", "25.0"]


def test_rows_that_are_missing_or_judged_on_other_rooms_are_refused() -> None:
    with pytest.raises(ValueError, match="every row must be judged, and on the same rooms"):
        tabulate(four(**{ROWS[1]: None}), np.random.default_rng(0))
    other = replace(four()[0], names=("Area_5/a", "Area_5/b", "Area_5/c", "Area_5/d"))
    with pytest.raises(ValueError, match="every row must be judged, and on the same rooms"):
        tabulate([*four(), other], np.random.default_rng(0))


def test_verdicts_are_kept_to_the_bit(tmp_path: Path) -> None:
    mine = judged(ROWS[2], 1, 3, 1)
    save_judged(tmp_path / SCORES, mine)
    again = load_judged(tmp_path / SCORES)
    assert (again.row, again.seed, again.names) == (mine.row, mine.seed, mine.names)
    for first, second in zip(mine.matches, again.matches, strict=True):
        assert (first.overlaps, first.truth_counts) == (second.overlaps, second.truth_counts)
        for name in ("labels", "overlap_idx", "scores", "correct"):
            assert np.array_equal(getattr(first, name), getattr(second, name))
            assert getattr(first, name).dtype == getattr(second, name).dtype


def test_every_training_is_done_once_and_more_seeds_are_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for area in range(1, 7):
        room = boxes_room([("chair", (0, 0, 0)), ("table", (1, 0, 0))], name=f"Area_{area}/office_1")
        room.save(room_path(tmp_path / "rooms", room.name))
    trained: list[tuple[str, int, int]] = []
    monkeypatch.setattr(table_module, "train_row", lambda t: trained.append((t.row, t.seed, t.config().points)))

    class Truth:
        @staticmethod
        def from_file(_: Path) -> Any:
            return lambda room, _: ground_truth(room)

    monkeypatch.setattr(table_module, "RoomPredictor", Truth)
    config = TableConfig(rooms=tmp_path / "rooms", steps=5, seeds=1, points=77, held_out=1)
    out = tmp_path / "out"
    first = list(judge_rows(config, out))
    assert trained == [(row, 0, 77) for row in ROWS]
    assert {one.names for one in first} == {("Area_5/office_1",)}
    (out / f"{ROWS[1]}-0" / SCORES).write_text("{")  # damaged
    trained.clear()
    rows = tabulate(list(judge_rows(replace(config, seeds=2), out)), np.random.default_rng(0), resamples=5)
    assert trained == [(ROWS[1], 0, 77), *((row, 1, 77) for row in ROWS)]
    assert [row.scores.mean_ap50 for row in rows] == [1.0] * 4
    assert replace(config, seeds=2).note() == config.note()
    assert replace(config, steps=6).note() != config.note()
    with pytest.raises(FileNotFoundError, match="holds no room of area 5"):
        judge_rows(replace(config, rooms=tmp_path / "nowhere"), out)


def test_nonsense_tables_are_named() -> None:
    with pytest.raises(ValueError, match="steps must be at least 1, got 0"):
        TableConfig(rooms=Path(), steps=0)
    with pytest.raises(ValueError, match="seeds must be at least 1, got 0"):
        TableConfig(rooms=Path(), steps=1, seeds=0)

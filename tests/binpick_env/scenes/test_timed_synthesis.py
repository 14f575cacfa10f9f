"""Scenes made within a time: the time is kept, and what was made before counts."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from binpick_env.options import CellOptions
from binpick_env.scenes import timed_synthesis as module
from binpick_env.scenes.synthesis import SceneConfig, ensure_folder_config, scene_path, scene_settings, with_room
from binpick_env.scenes.timed_synthesis import Making, SceneBudget, fine_tuning_scenes, load_making, make_scenes
from perception.runtime.files import json_text
from perception.segmentation.scene import SCENES_NOTE

SECONDS = 10.0  # that a scene takes


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Replace the synthesis by one that writes empty files and sets the clock forward."""
    now = [100.0]

    def generate(config: SceneConfig, count: int, folder: Path, workers: int) -> Iterator[int]:
        ensure_folder_config(config, folder)
        for index in range(count):
            if not scene_path(folder, index).exists():
                now[0] += SECONDS
                scene_path(folder, index).touch()
            yield index

    monkeypatch.setattr(module, "generate_scenes", generate)
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    return now


def made(tmp_path: Path, least: int = 1, most: int = 100, seconds: float | None = None) -> Iterator[tuple[int, Making]]:
    budget = SceneBudget(least=least, most=most, seconds=seconds)
    return make_scenes(fine_tuning_scenes(CellOptions(part="tee")), tmp_path / "scenes", budget, tmp_path / "time.json")


def done(seconds: float, count: int) -> Making:
    return Making(seconds=seconds, done=True, scenes=tuple(f"scene_{index:05d}.npz" for index in range(count)))


def files(tmp_path: Path) -> int:
    return len(list((tmp_path / "scenes").glob("scene_*.npz")))


def test_scenes_are_made_until_the_time_is_over(clock: list[float], tmp_path: Path) -> None:
    steps = list(made(tmp_path, seconds=35.0))
    assert steps[-1] == (4, done(4 * SECONDS, 4))
    assert [making.done for _, making in steps] == [False, False, False, True]
    assert load_making(tmp_path / "time.json") == steps[-1][1]
    assert files(tmp_path) == 4


def test_a_resumed_making_has_the_rest_of_the_time(clock: list[float], tmp_path: Path) -> None:
    making = made(tmp_path, seconds=55.0)
    next(making), next(making)
    making.close()  # type: ignore[attr-defined]
    assert load_making(tmp_path / "time.json") == Making(seconds=2 * SECONDS, done=False)
    clock[0] += 1000.0  # between the two starts
    *_, last = made(tmp_path, seconds=55.0)
    assert last == (6, done(6 * SECONDS, 6))
    assert files(tmp_path) == 6


def test_least_and_most_bound_the_number(clock: list[float], tmp_path: Path) -> None:
    *_, last = made(tmp_path, least=3, seconds=1.0)
    assert last == (3, done(3 * SECONDS, 3))
    *_, last = made(tmp_path, most=5)
    assert last == (5, done(5 * SECONDS, 5))


def test_scenes_of_other_settings_are_not_mixed_in(clock: list[float], tmp_path: Path) -> None:
    ensure_folder_config(replace(fine_tuning_scenes(CellOptions(part="tee")), sensor="good"), tmp_path / "scenes")
    with pytest.raises(ValueError, match=r"scenes holds too few scenes, and of other settings .* or delete this one"):
        next(made(tmp_path))
    assert files(tmp_path) == 0


def test_scenes_of_an_older_version_are_continued(clock: list[float], tmp_path: Path) -> None:
    config = with_room(fine_tuning_scenes(CellOptions(part="generated:hex_bolt:0")))
    note = scene_settings(config)
    del note["generator"]  # older versions did not write it
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / SCENES_NOTE).write_text(json_text(note))
    budget = SceneBudget(least=1, most=2)
    *_, last = make_scenes(config, tmp_path / "scenes", budget, tmp_path / "time.json")
    assert last[0] == 2


def test_the_scenes_settings_are_written(clock: list[float], tmp_path: Path) -> None:
    next(made(tmp_path))
    note = json.loads((tmp_path / "scenes" / SCENES_NOTE).read_text())
    assert (note["part"], note["seed"], note["sensor"], note["appearance"]) == ("tee", 0, "all", "varied")


def test_a_bin_gets_no_more_parts_than_it_has_room_for() -> None:
    small = with_room(SceneConfig(part="tee", bin=(0.16, 0.16, 0.08)))
    assert 1 <= small.num_parts[1] < 20
    large = SceneConfig(part="tee", bin=(0.5, 0.5, 0.2))
    assert with_room(large) == large


def test_a_damaged_state_is_named(tmp_path: Path) -> None:
    assert load_making(tmp_path / "time.json") is None
    (tmp_path / "time.json").write_text('{"seconds": 1.0, "done": true}')  # older files do not name scenes
    assert load_making(tmp_path / "time.json") == Making(seconds=1.0, done=True)
    for text in ("{", '{"seconds": 1.0}', "[]"):
        (tmp_path / "time.json").write_text(text)
        with pytest.raises(ValueError, match=r"time\.json is damaged .*; delete it, or choose another folder"):
            load_making(tmp_path / "time.json")


def test_nonsense_budgets_are_named() -> None:
    with pytest.raises(ValueError, match=r"1 <= least <= most, got 3 and 2"):
        SceneBudget(least=3, most=2)
    with pytest.raises(ValueError, match=r"seconds must not be negative, got -1\.0"):
        SceneBudget(least=1, most=2, seconds=-1.0)

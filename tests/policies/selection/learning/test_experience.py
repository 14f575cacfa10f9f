"""Cells, and the log of attempts in them: what is written, what is kept, and which files of older versions are read."""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binpick_env.camera.sensor import PRESETS
from binpick_env.options import CellOptions
from policies.selection.features import column
from policies.selection.learning import experience
from policies.selection.learning.experience import CONFIG, Attempts, Behaviour, Cells, ExperienceError
from tests.policies.selection.learning.toy_selection import CELLS, PARTS, ToySelection, attempt_log

# --- cells -----------------------------------------------------------------------------------------------------------


def test_cells_have_the_options_of_a_cell() -> None:
    options: dict[str, Any] = {"bin": (0.3, 0.2, 0.1), "hand_eye_mm": 10.0, "friction": 0.3, "jaw": 0.07}
    options |= {"camera_distance": 0.8, "width": 640, "height": 480, "density": 1000.0, "symmetry": "none"}
    env = Cells(min_parts=1, max_parts=2, max_failures=3, sensor="harsh", **options).environment()
    assert env.cell.config == CellOptions(**options).cell()
    assert env.cell.config.camera.hand_eye == 0.01
    assert env.cell.part is CellOptions(**options).load_part()
    assert (env.cell._num_parts, env.cell.sensor, env.max_failures) == ((1, 2), PRESETS["harsh"], 3)
    env.close()


def test_cells_are_written_as_json_gives_them_back() -> None:
    """The hand-eye error also under its former name, in metres."""
    plain = Cells(part="toy", bin=(0.3, 0.2, 0.1), hand_eye_mm=10).plain()
    assert set(plain) == {field.name for field in fields(Cells)} | {"hand_eye"}
    assert plain["bin"] == [0.3, 0.2, 0.1]
    assert (plain["hand_eye_mm"], plain["hand_eye"]) == (10.0, 0.01)


# --- logged attempts -------------------------------------------------------------------------------------------------


def test_epsilon_mixes_in_random_choices(tmp_path: Path, toys: None) -> None:
    for epsilon, low, high in ((0.0, 1.0, 1.0), (1.0, 0.2, 0.75)):
        log = attempt_log(tmp_path / str(epsilon), Behaviour(selector="highest", epsilon=epsilon))
        list(log.fill(range(30)))
        attempts = log.attempts(range(30))
        assert len(attempts) == 30 * PARTS
        tops = np.where(attempts.mask > 0, attempts.grasps[:, :, column("top")], -1)
        assert low <= np.mean(tops.argmax(axis=1) == attempts.chosen) <= high
        assert set(attempts.bins) == set(range(30))
        quality = attempts.grasps[np.arange(len(attempts)), attempts.chosen, column("quality")]
        np.testing.assert_array_equal(attempts.delivered, quality > 0.5)


def test_a_process_keeps_the_environment_of_the_last_cells_alone(
    tmp_path: Path, toys: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[ToySelection] = []

    def build(cells: Cells) -> ToySelection:
        assert len(experience._environments) == 0, "the former one is let go of before the next is built"
        built.append(ToySelection())
        return built[-1]

    monkeypatch.setattr(Cells, "environment", build)
    for k, max_failures in enumerate((2, 2, 3, 2)):
        cells = replace(CELLS, max_failures=max_failures)
        log = replace(attempt_log(tmp_path / str(max_failures)), cells=cells)
        list(log.fill([k]))
        assert list(experience._environments) == [cells]
    assert [env.closed for env in built] == [True, True, False]


def test_several_grasps_are_tried_from_each_state(tmp_path: Path, toys: None) -> None:
    log = attempt_log(tmp_path, Behaviour(tries=3))
    list(log.fill(range(4)))
    attempts = log.attempts(range(4))
    quality = attempts.grasps[np.arange(len(attempts)), attempts.chosen, column("quality")]
    np.testing.assert_array_equal(attempts.delivered, quality > 0.5)
    counts = []
    for k in range(4):
        for state in range(PARTS):
            own = (attempts.bins == k) & (attempts.states == state)
            assert len({row.tobytes() for row in attempts.grasps[own]}) == 1
            assert len(set(attempts.chosen[own])) == own.sum() == min(3, attempts.mask[own][0].sum())
            counts.append(own.sum())
    assert set(counts) == {1, 2, 3}
    assert sum(counts) == len(attempts)


def test_bins_without_attempts_cannot_be_learned_from(tmp_path: Path, toys: None) -> None:
    log = attempt_log(tmp_path)
    list(log.fill(range(1)))
    with np.load(log.file(0)) as file:
        empty = {name: file[name][:0] if file[name].ndim else file[name] for name in file.files}
    np.savez(log.file(1), **empty)
    with pytest.raises(ValueError, match="1 bins hold no attempt"):
        Attempts.load([log.file(1)])


def test_a_folder_holds_attempts_in_the_same_bins_alone(tmp_path: Path) -> None:
    attempt_log(tmp_path).claim()
    attempt_log(tmp_path).claim()
    for other in (attempt_log(tmp_path, seed=1), attempt_log(tmp_path, Behaviour(tries=2))):
        with pytest.raises(ExperienceError, match="holds attempts in other bins"):
            other.claim()


@pytest.mark.parametrize("hand_eye_mm", [0.0, 2.9, 10.0])
def test_a_folder_of_an_older_version_is_resumed(tmp_path: Path, hand_eye_mm: float) -> None:
    """It has the hand-eye error in metres, and lacks the options that came later: its bins had their defaults."""
    log = replace(attempt_log(tmp_path), cells=Cells(part="toy", bin=(0.3, 0.2, 0.1), hand_eye_mm=hand_eye_mm))
    log.claim()
    path = tmp_path / CONFIG
    present = json.loads(path.read_text())
    path.write_text(json.dumps({**present, "cells": older_cells(hand_eye_mm / 1000)}))
    log.claim()
    assert json.loads(path.read_text()) == present
    for other in (older_cells(0.007), {**present["cells"], "lid": True}):  # of another camera; of a newer version
        path.write_text(json.dumps({**present, "cells": other}))
        with pytest.raises(ExperienceError, match="holds attempts in other bins"):
            log.claim()


def older_cells(hand_eye: float) -> dict[str, Any]:
    """Return cells as they were written before ``hand_eye_mm``."""
    choices = {"part": "toy", "min_parts": 20, "max_parts": 30, "perception": "oracle", "pose_noise": None}
    limits = {"sensor": "good", "fast": False, "max_failures": 2, "bin": [0.3, 0.2, 0.1], "hand_eye": hand_eye}
    return {**choices, **limits}


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: Behaviour(epsilon=1.5), r"epsilon must be in \[0, 1\], got 1.5"),
        (lambda: Behaviour(tries=0), "tries must be at least 1, got 0"),
    ],
)
def test_nonsense_is_refused(build: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        build()

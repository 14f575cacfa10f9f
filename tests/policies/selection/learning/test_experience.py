"""Cells, and the log of attempts in them: what is written, what is kept, and which files of older versions are read."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from policies.selection.features import column
from policies.selection.learning.experience import CONFIG, Attempts, Behaviour, Cells, ExperienceError
from tests.policies.selection.learning.toy_selection import PARTS, attempt_log

# --- cells -----------------------------------------------------------------------------------------------------------


def test_cells_may_have_another_bin() -> None:
    env = Cells(min_parts=1, max_parts=2, bin=(0.3, 0.2, 0.1)).environment()
    assert env.cell.workspace.inner_size.tolist() == [0.3, 0.2, 0.1]
    env.close()


def test_cells_may_see_worse() -> None:
    env = Cells(min_parts=1, max_parts=2, hand_eye=0.01).environment()
    assert env.cell.config.camera.hand_eye == 0.01
    env.close()


def test_cells_are_written_as_json_gives_them_back() -> None:
    plain = Cells(part="toy", bin=(0.3, 0.2, 0.1)).plain()
    assert set(plain) == {field.name for field in fields(Cells)}
    assert plain["bin"] == [0.3, 0.2, 0.1]


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
        empty = {name: file[name][:0] for name in file.files}
    np.savez(log.file(1), **empty)
    with pytest.raises(ValueError, match="1 bins hold no attempt"):
        Attempts.load([log.file(1)])


def test_a_folder_holds_attempts_in_the_same_bins_alone(tmp_path: Path) -> None:
    attempt_log(tmp_path).claim()
    attempt_log(tmp_path).claim()
    for other in (attempt_log(tmp_path, seed=1), attempt_log(tmp_path, Behaviour(tries=2))):
        with pytest.raises(ExperienceError, match="holds attempts in other bins"):
            other.claim()


def test_a_folder_of_an_older_version_is_resumed(tmp_path: Path) -> None:
    """Before an option existed, all bins had its default."""
    log = attempt_log(tmp_path)
    log.claim()
    path = tmp_path / CONFIG
    present = json.loads(path.read_text())
    older = {**present, "cells": {name: value for name, value in present["cells"].items() if name != "bin"}}
    path.write_text(json.dumps(older))
    log.claim()
    assert json.loads(path.read_text()) == present
    path.write_text(json.dumps({**present, "cells": {**present["cells"], "lid": True}}))  # a newer version's
    with pytest.raises(ExperienceError, match="holds attempts in other bins"):
        log.claim()


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

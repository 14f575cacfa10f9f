"""``BinPickSelect-v0`` with a few parts, and what its tests do to it by hand."""

from typing import Any

import numpy as np
import pytest

from policies.grasping.outcomes import GraspOutcome
from policies.selection.env import GraspSelectionEnv
from tests.policies.fake_cell import attempt
from tests.policies.hand_cell import SMALL_IMAGE, HandCell

SMALL: dict[str, Any] = {"num_parts": (1, 3), "perception": "oracle", "threads": 1, "camera": SMALL_IMAGE}
Result = tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]


def lay(env: GraspSelectionEnv, *places: tuple[float, float]) -> None:
    """Begin an episode on parts laid by hand."""
    cell = HandCell(env.cell, env.picker)
    cell.lay(*(cell.flat(*place) for place in places))
    env._begin()


def choices(env: GraspSelectionEnv) -> list[int]:
    return [int(row) for row in np.flatnonzero(env.action_masks())]


def unexecuted(env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch, *outcomes: GraspOutcome) -> None:
    """Let attempts come out as they are told, without any motion."""
    script = iter(outcomes)
    monkeypatch.setattr(env.picker, "execute", lambda plan: attempt(next(script)))


def step(env: GraspSelectionEnv, row: int) -> Result:
    return env.step(np.int64(row))


def assert_same(first: Any, second: Any) -> None:
    """Compare observations or infos, arrays included."""
    assert first.keys() == second.keys()
    for key in first:
        np.testing.assert_array_equal(first[key], second[key], err_msg=key)

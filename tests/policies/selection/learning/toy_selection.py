"""Spaces of ``BinPickSelect-v0`` without physics: grasps of quality above a half are delivered."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np

from policies.grasping.outcomes import GraspOutcome, PickResult
from policies.selection.candidate_generator import ROWS
from policies.selection.features import FEATURES, HIGH, LOW, column
from policies.selection.learning.experience import AttemptLog, Behaviour, Cells
from policies.selection.network import SelectorNetConfig
from policies.selection.selectors import Selector

PARTS = 6
CELLS = Cells(part="toy")
SMALL_NET = SelectorNetConfig(hidden=16)


class ToySelection(gym.Env[dict[str, np.ndarray], np.int64]):
    def __init__(self) -> None:
        low, high = np.tile(LOW, (ROWS, 1)), np.tile(HIGH, (ROWS, 1))
        self.observation_space = gym.spaces.Dict(
            {"grasps": gym.spaces.Box(low, high), "mask": gym.spaces.Box(0, 1, (ROWS,), dtype=np.int8)}
        )  # type: ignore[assignment]
        self.action_space = gym.spaces.Discrete(ROWS)
        self.result: Any = None
        self.closed = False

    def close(self) -> None:
        self.closed = True

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self._left, self._delivered = PARTS, 0
        return self._observe(), self._info("")

    def probe(self, action: np.int64) -> PickResult:
        return PickResult(outcome=GraspOutcome.DELIVERED if self._delivers(action) else GraspOutcome.MISSED)

    def step(self, action: np.int64) -> Any:
        success = self._delivers(action)
        self.result = SimpleNamespace(success=success)
        self._left -= 1
        self._delivered += success
        outcome = "delivered" if success else "missed"
        return self._observe(), 1.0 if success else -0.1, self._left == 0, False, self._info(outcome)

    def action_masks(self) -> np.ndarray:
        return self._mask.astype(bool)

    def _delivers(self, action: np.int64) -> bool:
        return bool(self._grasps[action, column("quality")] > 0.5 and self._mask[action])

    def _observe(self) -> dict[str, np.ndarray]:
        valid = 1 + self.np_random.integers(5)
        self._mask = np.zeros(ROWS, np.int8)
        self._mask[:valid] = 1
        self._grasps = np.zeros((ROWS, len(FEATURES)), np.float32)
        self._grasps[:valid] = self.np_random.uniform(LOW, HIGH, (valid, len(FEATURES)))
        return {"grasps": self._grasps.copy(), "mask": self._mask.copy()}

    def _info(self, outcome: str) -> dict[str, Any]:
        success = self._delivered == PARTS
        return {"outcome": outcome, "delivered": self._delivered, "total": PARTS, "is_success": success}


def toy(cells: Cells) -> ToySelection:
    return ToySelection()


def attempt_log(folder: Path, behaviour: Behaviour | None = None, seed: int = 0) -> AttemptLog:
    return AttemptLog(folder=folder, cells=CELLS, behaviour=behaviour or Behaviour(), seed=seed)


def success(selector: Selector, bins: int = 30) -> float:
    """Return the share of attempts that deliver when ``selector`` chooses."""
    env, rng, delivered = ToySelection(), np.random.default_rng(0), 0
    for seed in range(bins):
        observation, over = env.reset(seed=1000 + seed)[0], False
        while not over:
            observation, _, over, _, _ = env.step(np.int64(selector.select(observation, rng)))
            delivered += env.result.success
    return delivered / (bins * PARTS)

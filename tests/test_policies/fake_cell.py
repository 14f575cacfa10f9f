"""A cell without physics and a picker that follows a script, for the tests of what is built on top of them."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from binpick_env.clutter import ClutterStats
from perception.frame import Frame
from perception.geometry import camera_matrix, make_transform
from policies.episode import BinResult, Termination
from policies.evaluation import Cell, EvaluationConfig
from policies.outcomes import Abstention, GraspCandidate, GraspOutcome, PickResult

LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])


def frame(width: int = 320, height: int = 240) -> Frame:
    """A grey plane 0.9 m under a camera at (0.5, 0, 0.9)."""
    return Frame(
        grey=np.full((height, width), 90, np.uint8),
        depth=np.full((height, width), 0.9, np.float32),
        K=camera_matrix(600.0, width, height),
        T_world_cam=make_transform(LOOKING_DOWN, (0.5, 0.0, 0.9)),
    )


def grasp(width: float = 0.03, opening: float = 0.05) -> GraspCandidate:
    """A grasp from above at (0.5, 0, 0)."""
    T = make_transform(LOOKING_DOWN, (0.5, 0.0, 0.0))
    return GraspCandidate(
        T_world_grasp=T, T_world_tcp=T, width=width, opening=opening, candidate=0, score=0.7, features={"quality": 0.5}
    )


def attempt(outcome: GraspOutcome, **facts: Any) -> PickResult:
    times = {"t_sense": 0.5, "t_compute": 0.25, "t_motion": 5.25} | facts
    success = outcome is GraspOutcome.DELIVERED
    return PickResult(outcome=outcome, grasp=grasp(), part=1, delivered=int(success), **times)


def abstain(reason: Abstention = Abstention.NO_CANDIDATE) -> PickResult:
    return PickResult(abstention=reason, t_sense=0.5, t_compute=0.1)


def bin_result(*picks: PickResult, seed: int = 1, parts: int = 10, lost: int = 0) -> BinResult:
    return BinResult(
        seed=seed,
        parts_total=parts,
        delivered=sum(pick.delivered for pick in picks),
        picks=tuple(picks),
        termination=Termination.ABSTAINED,
        clutter=ClutterStats.from_fractions(np.linspace(0.0, 1.0, parts)),
        lost=lost,
    )


@dataclass
class FakeEnv:
    """Counts what is asked of it."""

    parts: int = 3
    delivered: int = 0
    lost: int = 0
    looks: int = 0
    frame_id: int = -1
    truncated: bool = False
    render_time: float = 0.0
    closed: bool = False
    events: list[Any] = field(default_factory=list)
    seeds: list[int | None] = field(default_factory=list)

    @property
    def total(self) -> int:
        return self.parts

    @property
    def remaining(self) -> int:
        return self.parts - self.delivered - self.lost

    @property
    def exposure(self) -> Any:
        return SimpleNamespace(visible_fractions=np.linspace(0.1, 1.0, self.parts))

    @property
    def simulation(self) -> Any:
        return SimpleNamespace(in_play=np.ones(self.parts, dtype=bool))

    @property
    def frame(self) -> Frame:
        return frame()

    def reset(self, *, seed: int | None = None) -> None:
        self.seeds.append(seed)
        self.rng = np.random.default_rng(seed)
        self.delivered = self.lost = 0
        self.frame_id = 0

    def look(self) -> None:
        self.looks += 1
        self.frame_id += 1

    def close(self) -> None:
        self.closed = True


class ScriptPicker:
    """Returns the given results in order."""

    def __init__(self, env: FakeEnv, *script: PickResult) -> None:
        self.env, self.script = env, list(script)

    def reset(self) -> None:
        pass

    def pick(self) -> PickResult:
        result = self.script.pop(0)
        self.env.delivered += result.delivered
        self.env.frame_id += result.outcome is not None
        return result


class DicePicker:
    """Delivers four times out of five, by the environment's own dice."""

    def __init__(self, env: FakeEnv) -> None:
        self.env = env

    def reset(self) -> None:
        pass

    def pick(self) -> PickResult:
        success = self.env.rng.random() < 0.8
        self.env.delivered += success
        return attempt(GraspOutcome.DELIVERED if success else GraspOutcome.MISSED)


def dice_cell(config: EvaluationConfig) -> Cell:
    env = FakeEnv(parts=config.num_parts[0])
    return Cell(env, DicePicker(env))  # type: ignore[arg-type]


def broken_cell(config: EvaluationConfig) -> Cell:
    raise FloatingPointError("the physics diverged")

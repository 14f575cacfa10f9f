"""A real cell whose parts are laid by hand, a log of every control step, and perceivers that do not tell the truth."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakMethod

import numpy as np
import pytest

from binpick_env.candidates import PoseCandidate
from binpick_env.cell.robot import HOME
from binpick_env.config import CameraConfig
from binpick_env.env import BinPickEnv
from binpick_env.observation.candidate_from_pose import make_candidate
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.oracle import OraclePerceiver, PoseNoise
from binpick_env.observation.perceiver import Perceiver
from perception.geometry import Floats, make_transform, rotation_about
from policies.grasping.outcomes import Abstention, GraspOutcome, PickResult
from policies.picking.scripted import T_SENSE, ScriptedPicker
from tests.last_frame import change_depth

Fault = Callable[[Floats], Floats]
SMALL_BIN = 6
SMALL_IMAGE = CameraConfig(width=640, height=480)  # a frame takes a quarter of the time of the default's


@dataclass(frozen=True, eq=False, kw_only=True)
class Step:
    """One control step: what was commanded and what was felt."""

    action: Floats
    target: Floats
    height: float  # of the tcp [m]
    force: float  # of the robot's contacts [N]


@dataclass(eq=False)
class HandCell:
    """An environment with its picker. ``fault`` changes every action on its way to the robot."""

    env: BinPickEnv
    picker: ScriptedPicker
    log: list[Step] = field(default_factory=list)
    fault: Fault | None = None

    def lay(self, *T_bin_parts: Floats, unseen: Sequence[Floats] = (), seed: int = 0) -> None:
        """Lay parts, let them rest and take a frame; then lay the ``unseen`` ones. Forget all earlier picks."""
        env, simulation = self.env, self.env.simulation
        env.reset(seed=seed, options={"num_parts": len(T_bin_parts) + len(unseen)})
        for i in range(len(T_bin_parts), simulation.capacity):
            simulation.park(i)
        for i, T_bin_part in enumerate(T_bin_parts):
            simulation.place(i, env.workspace.T_world_bin @ T_bin_part)
        for _ in range(10):
            BinPickEnv.step(env, np.append(simulation.target, 0.0).astype(np.float32))
        env.look()
        for i, T_bin_part in enumerate(unseen, start=len(T_bin_parts)):
            simulation.place(i, env.workspace.T_world_bin @ T_bin_part)
        self.picker.reset()
        self.log.clear()
        self.fault = None

    def flat(self, x: float = 0.0, y: float = 0.0, *, yaw: float = 0.0, above: float = 0.0) -> Floats:
        """Return T_bin_part of a part as drawn, its lowest point on the bin's floor or ``above`` it [m]."""
        z = 0.0005 + above - float(self.env.part.model.mesh.vertices[:, 2].min())
        return make_transform(rotation_about((0, 0, 1), yaw), (x, y, z))

    @property
    def thickness(self) -> float:
        """Height of a part as drawn [m]."""
        return float(np.ptp(self.env.part.model.mesh.vertices[:, 2]))

    @property
    def at_home(self) -> bool:
        """Whether the arm is home with the jaw open."""
        simulation = self.env.simulation
        away = float(np.abs(simulation.joint_positions - HOME).max())
        return away < 0.02 and simulation.gripper_target == 0.0 and simulation.gripper_position < 0.1

    def see(self, depth: Floats) -> None:
        """Replace the last frame's depth (H, W) or a number for all of it."""
        change_depth(self.env, depth)

    def _step(self, action: Floats) -> Any:
        if self.fault is not None:
            action = self.fault(action.copy())
        returned = BinPickEnv.step(self.env, action.astype(np.float32))
        simulation = self.env.simulation
        height, force = float(simulation.T_world_tcp[2, 3]), simulation.robot_contact().force
        self.log.append(Step(action=action, target=simulation.target.copy(), height=height, force=force))
        return returned


def hand_cell(part: str, num_parts: int = 2, **options: Any) -> HandCell:
    env = BinPickEnv(part, num_parts=(1, num_parts), perception="oracle", camera=SMALL_IMAGE, **options)
    cell = HandCell(env, ScriptedPicker(env))
    step = WeakMethod(cell._step)  # an environment that held its cell would be freed by the garbage collector alone

    def logged(action: Floats) -> Any:
        log_step = step()
        assert log_step is not None
        return log_step(action)

    env.step = logged  # type: ignore[method-assign,assignment]
    return cell


@dataclass(frozen=True)
class Shifted:
    """The oracle, but the parts listed (all if None) are said to be elsewhere."""

    shift_world: tuple[float, float, float]
    parts: tuple[int, ...] | None = None

    def perceive(self, view: LabelledCapture, rng: np.random.Generator, *, likely: bool = False) -> ObservedCandidates:
        seen = OraclePerceiver().perceive(view, rng).candidates
        told = [self._moved(view, c) if self.parts is None or c.part in self.parts else c for c in seen]
        return ObservedCandidates(candidates=told)

    def _moved(self, view: LabelledCapture, candidate: PoseCandidate) -> PoseCandidate:
        T_world_part = make_transform(translation=self.shift_world) @ candidate.T_world_part
        return make_candidate(view, T_world_part, score=1.0, visible_fraction=1.0, fill=1.0, part=candidate.part)


@dataclass(frozen=True)
class Nameless:
    """Another perceiver's candidates without the true index."""

    inner: Perceiver

    def perceive(self, view: LabelledCapture, rng: np.random.Generator, *, likely: bool = False) -> ObservedCandidates:
        return ObservedCandidates(candidates=[replace(c, part=-1) for c in self.inner.perceive(view, rng).candidates])


@dataclass(frozen=True)
class Blind:
    """Sees nothing."""

    def perceive(self, view: LabelledCapture, rng: np.random.Generator, *, likely: bool = False) -> ObservedCandidates:
        return ObservedCandidates()


def noisy(translation: float) -> OraclePerceiver:
    return OraclePerceiver(PoseNoise(translation=translation))


def decision(result: PickResult) -> tuple[Any, ...]:
    """Return everything of a result that has to be the same each time: all but wall clock and the true index."""
    grasp = result.grasp
    aim = None if grasp is None else (grasp.T_world_tcp.tobytes(), grasp.opening, grasp.score, grasp.candidate)
    return result.outcome, result.abstention, aim, result.delivered, result.t_motion, result.frame_id


def lie(monkeypatch: pytest.MonkeyPatch, cell: HandCell, perceiver: Perceiver) -> None:
    monkeypatch.setattr(cell.env, "_perceiver", perceiver)


@contextmanager
def greased(cell: HandCell) -> Iterator[None]:
    friction = cell.env.simulation.model.geom_friction
    usual = friction.copy()
    friction[:] = 1e-4
    try:
        yield
    finally:
        friction[:] = usual


def assert_abstains(cell: HandCell, reason: Abstention) -> PickResult:
    """Pick, and check that nothing was moved for a reason."""
    frame_id, perception = cell.env.frame_id, cell.env.perception_time
    result = cell.picker.pick()
    assert (result.outcome, result.abstention) == (None, reason)
    assert (result.grasp, result.delivered, result.part) == (None, 0, -1)
    assert (result.t_motion, result.t_sense, result.frame_id) == (0.0, T_SENSE, frame_id)
    assert result.t_compute >= perception
    assert cell.log == []
    return result


def assert_fails(cell: HandCell, outcome: GraspOutcome, *, frames: int = 1) -> PickResult:
    """Pick, and check that it fails as named, and that the arm is home with the jaw open and the next frame taken."""
    frame_id = cell.env.frame_id
    result = cell.picker.pick()
    assert (result.outcome, result.abstention) == (outcome, None)
    assert not result.success
    assert result.delivered == 0
    assert result.t_motion > 1.0
    assert result.frame_id == frame_id
    assert cell.env.frame_id == frame_id + frames
    assert cell.at_home
    return result

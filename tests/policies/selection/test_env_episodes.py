"""``BinPickSelect-v0``: which candidates there are, what a step does, and when an episode ends."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from binpick_env import env as cell_module
from binpick_env.config import BinConfig, CellConfig
from binpick_env.observation.labelled_capture import LabelledCapture
from binpick_env.observation.observed_candidates import ObservedCandidates
from binpick_env.observation.oracle import OraclePerceiver
from perception.geometry import Floats
from policies.grasping.clearance import RankSettings
from policies.grasping.outcomes import Abstention, GraspOutcome
from policies.picking.episode import Termination
from policies.picking.plan import Plan
from policies.picking.settings import PickerSettings
from policies.selection.candidate_generator import ROWS
from policies.selection.env import ABSTAINED, GraspSelectionEnv
from policies.selection.features import column
from tests.policies.hand_cell import HandCell, Shifted
from tests.policies.selection_cell import SMALL, assert_same, choices, lay, step, unexecuted

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def shared_env() -> Iterator[GraspSelectionEnv]:
    env = GraspSelectionEnv(**SMALL)
    yield env
    env.close()


@pytest.fixture
def env(shared_env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> GraspSelectionEnv:
    monkeypatch.setattr(shared_env, "max_failures", 2)
    return shared_env


# --- candidates ------------------------------------------------------------------------------------------------------


def test_candidates_can_be_executed_and_the_first_row_is_the_scripted_choice(env: GraspSelectionEnv) -> None:
    lay(env, (0.1, 0.0), (-0.1, 0.03), (0.0, -0.05))
    grasps = env._candidates.grasps
    assert choices(env) == list(range(len(grasps)))
    assert sorted(grasp.candidate for grasp in grasps) == [0, 0, 0, 1, 1, 1, 2, 2, 2]  # per_part is 3
    assert sum(isinstance(env.picker.plan(grasp), Plan) for grasp in grasps) >= len(grasps) - 1
    first = env.picker._decide()
    assert isinstance(first, Plan)
    np.testing.assert_array_equal(grasps[0].T_world_tcp, first.grasp.T_world_tcp)


def test_rows_stand_in_order_and_empty_ones_are_zero(env: GraspSelectionEnv) -> None:
    observation, _ = env.reset(seed=3, options={"num_parts": 3})
    count = int(observation["mask"].sum())
    rank = observation["grasps"][:count, column("rank")]
    assert 0 < count < ROWS
    assert np.all(np.diff(rank) <= 0)
    assert not observation["grasps"][count:].any()
    assert not observation["mask"][count:].any()


def test_the_fingers_clearances_agree_with_the_rankings(env: GraspSelectionEnv) -> None:
    """Measured twice, by two kernels: at the chosen opening, and during the search for the widest clear opening."""
    for seed in range(3):
        observation, _ = env.reset(seed=seed, options={"num_parts": 3})
        rows = observation["grasps"][observation["mask"] == 1]
        fingers = rows[:, [column(f"clearance_{name}") for name in ("back", "front", "palm")]].min(axis=1)
        np.testing.assert_allclose(np.clip(fingers * 0.02 / 0.005, 0, 1), rows[:, column("clearance")], atol=1e-4)


def test_a_bin_out_of_reach_has_no_candidate() -> None:
    picker = PickerSettings(rank=RankSettings(per_candidate=1))
    env = GraspSelectionEnv(config=CellConfig(bin=BinConfig(position=(1.4, 0.0))), picker=picker, per_part=1, **SMALL)
    lay(env, (0.0, 0.0))
    assert (choices(env), env._candidates.reason) == ([], Abstention.IK_INFEASIBLE)
    env.close()


def test_a_pit_has_no_clear_approach(env: GraspSelectionEnv) -> None:
    lay(env, (0.0, 0.0))
    HandCell(env.cell, env.picker).see(np.array(0.0))
    env._generate()
    assert (choices(env), env._candidates.reason) == ([], Abstention.NO_CLEAR_APPROACH)


# --- steps -----------------------------------------------------------------------------------------------------------


def test_a_delivered_part_is_rewarded_and_the_last_one_ends_the_bin(env: GraspSelectionEnv) -> None:
    lay(env, (0.05, 0.0), (-0.08, 0.03))
    observation, reward, terminated, truncated, info = step(env, 1)
    assert (reward, terminated, truncated) == (1.0, False, False)
    assert (info["outcome"], info["delivered"], info["remaining"], info["total"]) == ("delivered", 1, 1, 2)
    assert (info["termination"], info["success"], info["t_sense"]) == ("", False, 0.5)
    assert info["t_motion"] > 1.0
    assert env.observation_space.contains(observation)
    np.testing.assert_array_equal(observation["mask"], info["action_mask"])
    assert env.result is not None
    assert env.result.t_compute == env.t_compute > 0.0
    observation, reward, terminated, truncated, info = step(env, 0)
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert (info["termination"], info["success"], info["is_success"]) == ("empty", True, True)
    assert not observation["mask"].any()
    with pytest.raises(RuntimeError, match=r"the episode is over, or has not begun: call reset\(\)"):
        step(env, 0)


def test_nothing_is_stepped_before_the_first_reset() -> None:
    env = GraspSelectionEnv(**SMALL)
    with pytest.raises(RuntimeError, match="has not begun"):
        step(env, 0)
    assert not env.action_masks().any()
    env.close()


@pytest.mark.parametrize("action", [ROWS, -1, 0.5])
def test_an_action_out_of_the_space_is_refused(env: GraspSelectionEnv, action: Any) -> None:
    lay(env, (0.0, 0.0))
    rows = re.escape(str(choices(env)))
    with pytest.raises(ValueError, match=rf"action must be an integer from 0 to 31, of which {rows} hold a grasp now"):
        env.step(action)


def test_an_empty_row_is_an_abstention_and_a_failure(env: GraspSelectionEnv) -> None:
    lay(env, (0.0, 0.0))
    before, frame_id, time = env._candidates.observation(), env.cell.frame_id, env.cell.simulation.time
    observation, reward, terminated, _, info = step(env, ROWS - 1)
    assert (reward, terminated, info["outcome"]) == (-0.1, False, ABSTAINED)
    assert_same(observation, before)  # nothing moves, and no other frame is taken
    assert (info["frame_id"], info["time"], info["t_motion"]) == (frame_id, time, 0.0)
    assert env.result is None
    _, reward, terminated, _, info = step(env, ROWS - 1)
    assert (reward, terminated, info["termination"]) == (-0.1, True, "2F")


def test_after_a_miss_the_grasp_is_gone_and_its_part_comes_last_as_a_suspect(
    env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    lie = Shifted((0.0, 0.06, 0.06), parts=(0,))  # much higher: all its grasps rank first
    monkeypatch.setattr(env.cell, "_perceiver", lie)
    lay(env, (0.05, -0.03), (-0.1, 0.03))
    tried = env._candidates.grasps[0]
    assert [grasp.candidate for grasp in env._candidates.grasps[:3]] == [tried.candidate] * 3
    observation, reward, terminated, _, info = step(env, 0)
    assert (reward, terminated, info["outcome"]) == (-0.1, False, "missed")
    suspect = observation["grasps"][: len(env._candidates.grasps), column("suspect")]
    assert suspect.tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    tips = np.stack([grasp.T_world_grasp[:3, 3] for grasp in env._candidates.grasps])
    turns = np.stack([grasp.T_world_grasp[:3, 2] for grasp in env._candidates.grasps]) @ tried.T_world_grasp[:3, 2]
    near = np.linalg.norm(tips - tried.T_world_grasp[:3, 3], axis=1) < 0.001
    assert not np.any(near & (turns > 0.999))


# --- how episodes end ------------------------------------------------------------------------------------------------

MISSED, DELIVERED = GraspOutcome.MISSED, GraspOutcome.DELIVERED


def test_failures_in_a_row_end_a_bin(env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    lay(env, (0.0, 0.0))
    for max_failures, outcomes, ends in (
        (2, [MISSED, MISSED], True),
        (2, [MISSED, DELIVERED, MISSED], False),
        (1, [DELIVERED, MISSED], True),
        (3, [MISSED, MISSED], False),
        (None, [MISSED] * 6, False),
    ):
        env._begin()  # nothing has moved
        monkeypatch.setattr(env, "max_failures", max_failures)
        unexecuted(env, monkeypatch, *outcomes)
        for n, outcome in enumerate(outcomes, start=1):
            _, reward, terminated, truncated, info = step(env, 0)
            assert reward == (1.0 if outcome is DELIVERED else -0.1)
            assert (terminated, truncated) == (ends and n == len(outcomes), False), (max_failures, outcomes[:n])
        assert info["termination"] == ("2F" if ends else ""), (max_failures, outcomes)


def test_an_abstention_adds_to_the_failures(env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    lay(env, (0.0, 0.0))
    unexecuted(env, monkeypatch, MISSED)
    assert not step(env, 0)[2]
    assert step(env, ROWS - 1)[4]["termination"] == "2F"


def test_the_cells_time_truncates(env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    lay(env, (0.0, 0.0))
    unexecuted(env, monkeypatch, MISSED)
    monkeypatch.setattr(cell_module, "MAX_EPISODE_STEPS", 0)
    *_, terminated, truncated, info = step(env, 0)
    assert (terminated, truncated, info["termination"]) == (False, True, str(Termination.TIME))


@dataclass
class Intermittent:
    """The oracle on the listed frames and no part on the others; frames and requests for likely ones are counted."""

    frames_with_parts: tuple[int, ...]
    count: int = 0
    frames: list[Floats] = field(default_factory=list)
    likely: list[bool] = field(default_factory=list)

    def perceive(self, view: LabelledCapture, rng: np.random.Generator, *, likely: bool = False) -> ObservedCandidates:
        self.count += 1
        self.frames.append(view.capture.frame.depth)
        self.likely.append(likely)
        return OraclePerceiver().perceive(view, rng) if self.count in self.frames_with_parts else ObservedCandidates()


def test_a_frame_without_parts_is_followed_by_one_with_fresh_noise(
    env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    perceiver = Intermittent(frames_with_parts=(2,))
    monkeypatch.setattr(env.cell, "_perceiver", perceiver)
    observation, info = env.reset(seed=1)
    assert (perceiver.count, info["frame_id"]) == (2, 1)
    assert observation["mask"].any()
    assert np.any(perceiver.frames[0] != perceiver.frames[1])
    assert perceiver.likely == [False, True]  # as in `run_bin`
    unexecuted(env, monkeypatch, MISSED)
    assert step(env, 0)[4]["t_sense"] == 1.0  # both frames were for this decision
    assert perceiver.count == 2  # no motion, no frame: a frame is processed once


def test_a_fresh_bin_without_candidates_ends_with_the_first_step(
    env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    perceiver = Intermittent(frames_with_parts=())
    monkeypatch.setattr(env.cell, "_perceiver", perceiver)
    observation, info = env.reset(seed=1)
    assert perceiver.count == 2
    assert not observation["mask"].any()
    assert not observation["grasps"].any()
    before = env.cell.simulation.time
    observation, reward, terminated, truncated, info = step(env, 7)
    assert (reward, terminated, truncated) == (0.0, True, False)
    assert (info["termination"], info["outcome"], info["t_sense"]) == ("abstained", "", 1.0)
    assert (env.cell.simulation.time, perceiver.count) == (before, 2)


def test_two_frames_without_parts_after_an_attempt_end_the_bin(
    env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay(env, (0.05, 0.0), (-0.08, 0.03))
    perceiver = Intermittent(frames_with_parts=())
    monkeypatch.setattr(env.cell, "_perceiver", perceiver)
    observation, reward, terminated, _, info = step(env, 0)
    assert (reward, terminated, info["termination"]) == (1.0, True, "abstained")
    assert (perceiver.count, info["t_sense"], info["remaining"]) == (2, 1.5, 1)
    assert not observation["mask"].any()


def test_each_attempt_may_have_a_second_frame(env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    perceiver = Intermittent(frames_with_parts=(2, 4))
    lay(env, (0.05, 0.0), (-0.08, 0.03))
    monkeypatch.setattr(env.cell, "_perceiver", perceiver)
    *_, terminated, _, _ = step(env, 0)
    assert (terminated, perceiver.count) == (False, 2)
    assert step(env, 0)[4]["termination"] == "empty"
    assert perceiver.count == 3


def test_a_blocked_path_masks_its_row_and_is_no_failure(
    env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    lay(env, (0.0, 0.0))
    rows = choices(env)
    assert len(rows) == 3
    perceiver = Intermittent(frames_with_parts=tuple(range(10)))
    monkeypatch.setattr(env.cell, "_perceiver", perceiver)
    monkeypatch.setattr(env.picker, "plan", lambda grasp: Abstention.NO_CLEAR_APPROACH)
    for left in ([0, 2], [0]):
        row = next(row for row in choices(env) if row not in left)
        observation, reward, terminated, _, info = step(env, row)
        assert (reward, terminated, info["outcome"]) == (-0.1, False, "no_clear_approach")
        assert choices(env) == left
        assert not observation["grasps"][row].any()
    assert perceiver.count == 0
    assert step(env, 0)[2] is False  # the last one: a second frame, which has them again
    assert (choices(env), perceiver.count) == (rows, 1)
    assert [step(env, row)[2] for row in rows] == [False, False, True]  # and no third one
    assert perceiver.count == 1

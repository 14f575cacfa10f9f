"""The fast mode: what it leaves out, and that the rest comes out as in full."""

from typing import Any

import numpy as np
import pytest

from binpick_env.cell.kinematic_motion import KinematicMotion
from binpick_env.cell.robot import HOME
from binpick_env.env import BinPickEnv
from policies.grasping.outcomes import GraspOutcome, PickResult
from policies.picking.execution import ExecutionSettings
from policies.picking.fast_execution import FastExecution
from policies.selection.candidate_generator import CandidateGenerator
from policies.selection.env import GraspSelectionEnv
from policies.selection.fast_agreement import PairedAttempt, agreement_table, paired_attempts
from tests.policies.hand_cell import HandCell
from tests.policies.selection_cell import SMALL, choices, lay, step

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def full() -> GraspSelectionEnv:
    return GraspSelectionEnv(**SMALL)


@pytest.fixture(scope="module")
def fast() -> GraspSelectionEnv:
    return GraspSelectionEnv(**SMALL, fast=True)


def count_steps(env: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Let the physics' control steps be counted."""
    steps: list[int] = []
    real = env.cell.simulation.step

    def counted(*arguments: Any) -> None:
        steps.append(1)
        real(*arguments)

    monkeypatch.setattr(env.cell.simulation, "step", counted)
    return steps


# --- cells of their own, before those that tests share are made


@pytest.mark.parametrize(("part", "outcome"), [("part_a", GraspOutcome.COLLIDED), ("part_b", GraspOutcome.DOUBLE)])
def test_what_the_frame_did_not_show_has_its_effect(part: str, outcome: GraspOutcome) -> None:
    """Kinematic motion ends before a part that is not in the frame; two lids in one jaw are not a lone load."""
    env = GraspSelectionEnv(part, **SMALL, fast=True)
    cell = HandCell(env.cell, env.picker)
    cell.lay(cell.flat(), unseen=[cell.flat(above=cell.thickness + 0.001)])
    assert env.picker.pick().outcome is outcome
    assert np.all(np.isfinite(env.cell.simulation.part_centres()))
    env.close()


# --- cells that tests share


def test_a_bin_is_emptied_with_a_third_of_the_steps(
    full: GraspSelectionEnv, fast: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = []
    for env in (full, fast):
        lay(env, (0.08, 0.0), (-0.08, 0.02))
        steps = count_steps(env, monkeypatch)
        infos = []
        while env._running:
            infos.append(step(env, choices(env)[0])[4])
        assert [info["outcome"] for info in infos] == ["delivered", "delivered"]
        assert infos[-1]["is_success"]
        counts.append(len(steps))
    assert counts[1] < counts[0] / 2.5


def test_the_first_frame_of_an_oracle_is_the_full_ones(full: GraspSelectionEnv, fast: GraspSelectionEnv) -> None:
    """Only the grey image is another."""
    (one, _), (other, _) = full.reset(seed=8), fast.reset(seed=8)
    np.testing.assert_array_equal(one["grasps"], other["grasps"])
    np.testing.assert_array_equal(full.cell.frame.depth, fast.cell.frame.depth)
    assert np.any(full.cell.frame.grey != fast.cell.frame.grey)


def test_the_arm_is_home_and_the_pile_asleep_at_each_frame(fast: GraspSelectionEnv) -> None:
    lay(fast, (0.06, 0.0), (0.06, 0.05), (-0.08, 0.0))
    before = fast.cell.frame_id
    step(fast, choices(fast)[0])
    simulation = fast.cell.simulation
    assert fast.cell.frame_id == before + 1
    np.testing.assert_allclose(simulation.joint_positions, HOME, atol=0.02)
    assert simulation.asleep()[simulation.in_play].all()
    assert simulation.gripper_position < 0.05
    assert fast.cell.unjudged() == frozenset()


def test_two_fast_copies_stay_equal(fast: GraspSelectionEnv) -> None:
    envs = [fast, GraspSelectionEnv(**SMALL, fast=True)]
    for env in envs:
        env.reset(seed=12)
    over = False
    while not over:
        row = choices(envs[0])[-1]
        (one, *ends), (other, *same) = (step(env, row) for env in envs)
        np.testing.assert_array_equal(one["grasps"], other["grasps"])
        assert ends[:3] == same[:3]
        over = ends[1]


@pytest.fixture
def kinematic(full: GraspSelectionEnv) -> tuple[BinPickEnv, KinematicMotion]:
    return full.cell, KinematicMotion(full.cell.simulation)


def test_no_frame_is_taken_over_the_tray(kinematic: tuple[BinPickEnv, KinematicMotion]) -> None:
    env, motion = kinematic
    env.reset(seed=0)
    execution = FastExecution(env, ExecutionSettings(look_ahead=True), motion)
    execution.look_when(lambda: True)
    execution.look_ahead()
    assert (env.frame_id, execution.looked_ahead) == (0, False)


def test_kinematic_motion_ends_where_the_physics_end(kinematic: tuple[BinPickEnv, KinematicMotion]) -> None:
    """After steps at constant velocity the arm is within half a milliradian of where it is put."""
    env, motion = kinematic
    env.reset(seed=0)
    simulation = env.simulation
    way = HOME + np.linspace(0, 1, 11)[:, None] ** 2 * np.array([0.2, -0.1, 0.1, 0.05, 0.0, 0.1])
    for q in way[1:]:
        simulation.step(q, 0.4)
    stepped, speeds = simulation.joint_positions, simulation.joint_velocities
    motion.place(way[-2], way[-1], 0.4)
    np.testing.assert_allclose(simulation.joint_positions, stepped, atol=2e-3)
    np.testing.assert_allclose(simulation.joint_velocities, speeds, atol=0.05)
    simulation.step(way[-1], 0.4)
    assert simulation.gripper_position == pytest.approx(0.4, abs=0.03)
    np.testing.assert_allclose(simulation.joint_positions, way[-1], atol=5e-3)


def test_touch_is_noticed_and_a_gripped_part_is_a_lone_load(kinematic: tuple[BinPickEnv, KinematicMotion]) -> None:
    env, motion = kinematic
    env.reset(seed=0)
    assert not motion.touches()
    assert motion.lone_load() is None
    inside = HOME.copy()
    inside[1] += 1.2  # into the bin or the table
    motion.place(HOME, inside, 0.0)
    assert motion.touches()


def test_a_load_is_carried_as_it_hangs(fast: GraspSelectionEnv) -> None:
    """The part keeps its place in the jaw."""
    lay(fast, (0.05, 0.0))
    poses: list[np.ndarray] = []
    motion = fast.picker._execution.keywords["motion"]  # type: ignore[union-attr]
    carry = motion.carry

    def watched(part: int, target: np.ndarray) -> None:
        simulation = fast.cell.simulation
        for call in (lambda: None, lambda: carry(part, target)):
            call()
            simulation.refresh()
            poses.append(np.linalg.inv(simulation.T_world_tcp) @ simulation.part_poses()[part])

    motion.carry = watched
    try:
        assert step(fast, choices(fast)[0])[4]["outcome"] == "delivered"
    finally:
        motion.carry = carry
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-9)


def test_pairs_start_from_one_state_and_agree(full: GraspSelectionEnv, fast: GraspSelectionEnv) -> None:
    pairs = list(paired_attempts(full, fast, seed=40, count=3))
    assert [pair.agree for pair in pairs] == [True, True, True]
    assert "equal in delivery" in agreement_table(pairs)


def test_a_state_in_the_other_mode_is_the_same(full: GraspSelectionEnv, fast: GraspSelectionEnv) -> None:
    full.reset(seed=41)
    fast.reset(seed=42)
    fast.cell.restore(full.cell.snapshot())
    np.testing.assert_array_equal(full.cell.simulation.part_poses(), fast.cell.simulation.part_poses())
    assert fast.cell.remaining == full.cell.remaining
    candidates = [CandidateGenerator(env.cell, env.picker).generate() for env in (full, fast)]
    np.testing.assert_array_equal(candidates[0].rows, candidates[1].rows)


def test_the_agreement_is_counted() -> None:
    def pair(one: GraspOutcome, other: GraspOutcome) -> PairedAttempt:
        return PairedAttempt(full=one, fast=other, seconds=(2.0, 1.0), shift=0.001)

    D, M, S = GraspOutcome.DELIVERED, GraspOutcome.MISSED, GraspOutcome.SLIPPED
    text = agreement_table([pair(D, D), pair(M, S), pair(D, M)])
    assert "2 / 3" in text  # in delivery
    assert "1 / 3" in text  # in outcome
    assert "2 and 1" in text
    assert "2.00 times as fast" in text
    assert "missed in full, slipped fast" in text
    assert "delivered in full, missed fast" in text


def test_time_is_passed_on_without_motion(kinematic: tuple[BinPickEnv, KinematicMotion]) -> None:
    env, _ = kinematic
    env.reset(seed=0)
    before = env.simulation.time
    env.skip(5)
    assert env.simulation.time == pytest.approx(before + 0.2)
    with pytest.raises(ValueError, match="steps must not be negative, got -1"):
        env.skip(-1)


def test_too_few_attempts_are_said(
    full: GraspSelectionEnv, fast: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("policies.selection.fast_agreement.MAX_PILES", 0)
    with pytest.raises(RuntimeError, match="0 piles did not give 1 attempts"):
        list(paired_attempts(full, fast, seed=0, count=1))


@pytest.mark.parametrize("mode", [pytest.param("full", marks=pytest.mark.slow), "fast"])
def test_a_probe_leaves_no_trace(mode: str, request: pytest.FixtureRequest) -> None:
    env: GraspSelectionEnv = request.getfixturevalue(mode)
    ends = []
    for probing in (False, True):
        env.reset(seed=8)
        for row in choices(env)[:2] if probing else []:
            result = env.probe(row)
            assert isinstance(result, PickResult)
            assert result.success
        after, reward, *_ = step(env, choices(env)[-1])
        ends.append((after["grasps"].tobytes(), reward, env.cell.simulation.data.qpos.tobytes(), env.cell.frame_id))
    assert ends[0] == ends[1]


def test_no_frame_is_taken_after_a_probe(fast: GraspSelectionEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    fast.reset(seed=8)
    monkeypatch.setattr(BinPickEnv, "look", lambda _: pytest.fail("a frame was taken"))
    fast.probe(choices(fast)[0])


def test_what_is_no_candidate_cannot_be_probed(fast: GraspSelectionEnv) -> None:
    fast.reset(seed=8)
    with pytest.raises(ValueError, match=r"row 31 holds no grasp, only \[0, "):
        fast.probe(np.int64(31))
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        GraspSelectionEnv(**SMALL).probe(np.int64(0))

"""One attempt step by step, on an environment that only takes notes."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain, combinations
from types import SimpleNamespace

import numpy as np
import pytest

from binpick_env.cell.delivery import Delivery
from binpick_env.cell.robot import HOME
from perception.geometry import Floats
from policies.grasping.outcomes import GraspOutcome
from policies.motion.trajectory import Trajectory
from policies.picking.execution import Execution, ExecutionSettings

SETTINGS = ExecutionSettings()
EMPTY = 0.8  # gripper position from which the jaw holds nothing, in these tests


@dataclass
class NoteEnv:
    """Environment and simulation in one. Takes actions at their word; is told what to answer after n steps."""

    holds: Callable[[int], bool] = lambda _: True
    force: Callable[[int], float] = lambda _: 0.0
    jaw: Callable[[int], float] = lambda _: 0.5
    loose: Callable[[int], bool] = lambda _: False
    ends_after: int = 10_000
    frame_id: int = 0
    target: Floats = field(default_factory=HOME.copy)
    actions: list[np.ndarray] = field(default_factory=list)

    @property
    def simulation(self) -> "NoteEnv":
        return self

    @property
    def gripper_position(self) -> float:
        return self.jaw(len(self.actions))

    def gripped(self) -> frozenset[int]:
        return frozenset({0}) if self.holds(len(self.actions)) else frozenset()

    def robot_contact(self) -> SimpleNamespace:
        return SimpleNamespace(force=self.force(len(self.actions)))

    def unjudged(self) -> frozenset[int]:
        return frozenset({0}) if self.loose(len(self.actions)) else frozenset()

    @property
    def truncated(self) -> bool:
        return len(self.actions) >= self.ends_after

    def step(self, action: np.ndarray) -> None:
        assert action.shape == (7,)
        assert action.dtype == np.float32
        self.actions.append(action)
        self.target = action[:6].astype(float)


def execution(env: NoteEnv, settings: ExecutionSettings = SETTINGS) -> Execution:
    return Execution(env, settings)  # type: ignore[arg-type]


def trajectory(count: int = 6, marks: tuple[int, ...] = (2, 4, 5)) -> Trajectory:
    """From home, every joint moves 0.1 rad a sample."""
    q = HOME + 0.1 * np.arange(count)[:, None]
    return Trajectory(t=0.04 * np.arange(count), q=q, qd=np.zeros((count, 6)), marks=marks)


def sent(env: NoteEnv) -> np.ndarray:
    return np.stack(env.actions)


# --- steps -----------------------------------------------------------------------------------------------------------


def test_a_trajectory_is_followed_from_its_second_sample_to_its_last() -> None:
    env = NoteEnv(force=lambda _: 1e6)
    assert execution(env).follow(trajectory(), 0.25)  # without a guard, the force is ignored
    np.testing.assert_allclose(sent(env)[:, :6], trajectory().q[1:], atol=1e-6)
    assert np.all(sent(env)[:, 6] == 0.25)


@pytest.mark.parametrize(("hit", "steps"), [(1, 1), (3, 3), (5, 5)])
def test_the_guard_stops_at_the_first_step_that_pushes_too_hard(hit: int, steps: int) -> None:
    env = NoteEnv(force=lambda n: 60.1 if n >= hit else 60.0)
    attempt = execution(env)
    assert not attempt.follow(trajectory(), 0.0, guard=True)
    assert len(env.actions) == steps
    assert attempt.outcome([]) is GraspOutcome.COLLIDED


def test_the_guard_lets_the_stop_force_itself_pass() -> None:
    env = NoteEnv(force=lambda _: SETTINGS.stop_force)
    assert execution(env).follow(trajectory(), 0.0, guard=True)
    assert not execution(NoteEnv(force=lambda _: 9.0), ExecutionSettings(stop_force=8.0)).follow(
        trajectory(), 0.0, guard=True
    )


@pytest.mark.parametrize(("force", "steps", "felt"), [(9.9, 5, False), (10.0, 3, True)])
def test_a_motion_until_a_force_ends_where_it_is_felt(force: float, steps: int, felt: bool) -> None:
    env = NoteEnv(force=lambda n: force if n == 3 else 0.0)
    assert execution(env).until_force(trajectory().q[1:], 0.9, 10.0) is felt
    assert len(env.actions) == steps
    assert np.all(sent(env)[:, 6] == np.float32(0.9))


def test_closing_ends_when_the_jaw_rests_and_not_before_it_has_set_off() -> None:
    rests = NoteEnv(jaw=lambda n: min(0.1 * n, 0.6))
    execution(rests).close()
    assert len(rests.actions) == 7
    stuck = NoteEnv(jaw=lambda _: 0.0)
    execution(stuck).close()
    assert len(stuck.actions) == 4
    assert np.all(sent(stuck)[:, 6] == 1.0)
    np.testing.assert_allclose(sent(stuck)[:, :6], np.tile(HOME, (4, 1)), atol=1e-6)


def test_closing_does_not_wait_longer_than_it_may() -> None:
    env = NoteEnv(jaw=lambda n: 0.01 * n)
    execution(env).close()
    assert len(env.actions) == round(SETTINGS.close_time / 0.04)


@pytest.mark.parametrize(("jaw", "holds"), [(EMPTY - 1e-3, True), (EMPTY, False), (1.0, False)])
def test_an_empty_jaw_is_noticed_where_the_lift_ends(jaw: float, holds: bool) -> None:
    env = NoteEnv(jaw=lambda n: jaw if n == 2 else 0.5)
    assert execution(env).carry(trajectory(), EMPTY) is holds
    assert len(env.actions) == (5 if holds else 2)
    assert np.all(sent(env)[:, 6] == 1.0)


def test_what_the_jaw_is_before_and_after_the_lift_is_not_asked() -> None:
    env = NoteEnv(jaw=lambda n: 0.5 if n == 2 else 1.0)
    assert execution(env).carry(trajectory(), EMPTY)


def test_releasing_opens_the_jaw_where_the_arm_is() -> None:
    env = NoteEnv()
    execution(env).release()
    assert len(env.actions) == round(SETTINGS.release_time / 0.04)
    np.testing.assert_allclose(sent(env), np.tile(np.append(HOME, 0.0), (4, 1)), atol=1e-6)


def test_retracing_goes_the_same_way_back_with_the_jaw_open() -> None:
    env = NoteEnv()
    attempt = execution(env)
    attempt.follow(trajectory(), 0.3)
    attempt.retrace()
    np.testing.assert_allclose(sent(env)[5:, :6], trajectory().q[-2::-1], atol=1e-6)
    assert np.all(sent(env)[5:, 6] == 0.0)


@pytest.mark.parametrize(("judged_after", "steps"), [(0, 0), (7, 7), (1000, 38)])
def test_waiting_ends_with_the_judgement_or_with_its_time(judged_after: int, steps: int) -> None:
    env = NoteEnv(loose=lambda n: n < judged_after)
    execution(env).await_judgement()
    assert len(env.actions) == steps
    assert all(action[6] == 0.0 for action in env.actions)


# --- outcomes --------------------------------------------------------------------------------------------------------

# What the jaw truly held after closing, after the lift, and over the tray: then the name of what it is.
HISTORIES = {
    "collided": GraspOutcome.COLLIDED,
    "nothing happened": GraspOutcome.MISSED,
    "held: no": GraspOutcome.MISSED,
    "held: no no no": GraspOutcome.MISSED,
    "held: no yes yes": GraspOutcome.MISSED,
    "held: yes": GraspOutcome.SLIPPED,
    "held: yes no": GraspOutcome.SLIPPED,
    "held: yes no no": GraspOutcome.SLIPPED,
    "held: yes no yes": GraspOutcome.SLIPPED,
    "held: yes yes no": GraspOutcome.DROPPED,
    "held: yes yes yes": GraspOutcome.NOT_SETTLED,
}
# The first of them that happened names the outcome; a part that fell into the tray unreleased names none.
EVENTS = (
    (Delivery.DELIVERED, GraspOutcome.DELIVERED),
    (Delivery.DOUBLE, GraspOutcome.DOUBLE),
    (Delivery.LEFT_BIN, GraspOutcome.LEFT_BIN),
)


def lived(history: str) -> Execution:
    """Return an execution to which ``history`` has happened."""
    env = NoteEnv()
    attempt = execution(env)
    if history == "collided":
        env.force = lambda _: 100.0
        attempt.follow(trajectory(), 0.0, guard=True)
    held = [word == "yes" for word in history.removeprefix("held:").split()] if history.startswith("held:") else []
    if held:
        env.holds = lambda _: held[0]
        attempt.close()
    if held[1:]:
        lifted = len(env.actions) + 2
        env.holds = lambda n: held[1 if n == lifted else -1]
        env.jaw = lambda _: 0.5 if len(held) == 3 else 1.0  # with two, the jaw was found empty and the carry ended
        attempt.carry(trajectory(), EMPTY)
    return attempt


@pytest.mark.parametrize("history", HISTORIES)
def test_the_first_thing_that_went_wrong_names_the_outcome(history: str) -> None:
    assert lived(history).outcome([]) is HISTORIES[history]


@pytest.mark.parametrize("history", HISTORIES)
def test_what_left_play_goes_before_what_was_held(history: str) -> None:
    attempt = lived(history)
    for kinds in chain.from_iterable(combinations(Delivery, n) for n in range(5)):
        named = [outcome for kind, outcome in EVENTS if kind in kinds]
        expected = named[0] if named else HISTORIES[history]
        assert attempt.outcome(list(kinds)) is expected, kinds
        assert attempt.outcome(list(reversed(kinds))) is expected  # in whatever order it happened


def test_a_double_of_two_parts_is_one_outcome() -> None:
    assert lived("held: yes yes yes").outcome([Delivery.DOUBLE, Delivery.DOUBLE]) is GraspOutcome.DOUBLE


def test_nothing_moves_after_the_episode_is_truncated() -> None:
    env = NoteEnv(ends_after=3)
    execution(env).release()
    assert len(env.actions) == 3

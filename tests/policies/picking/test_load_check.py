"""One part or more, from made-up readings of the jaw and of the force."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binpick_env.cell.wrist_force import GRAVITY, WristForceNoise
from binpick_env.config import CONTROL_PERIOD
from policies.picking.load_check import DoubleSettings, LoadCheck

MASS = 0.1
QUIET = DoubleSettings(force=WristForceNoise(noise=0.0, drift=0.0))
JAW: Any = SimpleNamespace(gap=lambda position: 0.085 * (1 - position))


@dataclass
class Hand:
    """Simulation and sensor in one; parts rise with the tcp where ``carried`` says so."""

    carried: tuple[bool, ...] = (True, False)
    height: float = 0.1
    force: float = 0.0
    gap: float = 0.02
    tared: int = 0
    part: Any = field(default_factory=lambda: SimpleNamespace(mass=MASS))

    @property
    def gripper_position(self) -> float:
        return 1 - self.gap / 0.085

    @property
    def T_world_tcp(self) -> np.ndarray:
        T = np.eye(4)
        T[2, 3] = self.height
        return T

    @property
    def in_play(self) -> np.ndarray:
        return np.ones(len(self.carried), bool)

    def part_centres(self) -> np.ndarray:
        return np.array([[0.0, 0.0, self.height - 0.02 if carried else 0.05] for carried in self.carried])

    def tare(self) -> None:
        self.tared += 1

    def read(self) -> float:
        return self.force


def lift(hand: Hand, heights: np.ndarray, forces: np.ndarray, settings: DoubleSettings = QUIET) -> LoadCheck:
    check = LoadCheck(hand, JAW, 0.02, settings, hand)  # type: ignore[arg-type]
    for hand.height, hand.force in zip(heights.tolist(), forces.tolist(), strict=True):
        check.feel()
    return check


def steady(hand: Hand, force: float, settings: DoubleSettings = QUIET) -> LoadCheck:
    return lift(hand, 0.1 + 0.01 * np.arange(20), np.full(20, force), settings)


@pytest.mark.parametrize(("parts", "double"), [(0.9, False), (1.45, False), (1.55, True), (2.0, True)])
def test_a_load_of_more_than_one_and_a_half_parts_is_more_than_one(parts: float, double: bool) -> None:
    check = steady(Hand(), parts * GRAVITY * MASS)
    assert check.decide() is double
    assert check.result is not None
    assert (check.result.weight, check.result.jaw) == (double, False)
    assert check.result.load == pytest.approx(parts)


@pytest.mark.parametrize(("gap", "double"), [(0.018, False), (0.0239, False), (0.0241, True)])
def test_a_jaw_that_closed_too_little_holds_more_than_one(gap: float, double: bool) -> None:
    check = steady(Hand(gap=gap), GRAVITY * MASS)
    assert check.decide() is double
    assert check.result is not None
    assert check.result.jaw is double
    assert check.result.jaw_excess == pytest.approx(gap - 0.02)


@pytest.mark.parametrize("reason", ["jaw", "weight"])
def test_a_reason_that_does_not_count_is_recorded_all_the_same(reason: str) -> None:
    settings = DoubleSettings(force=QUIET.force, **{"jaw": True, "weight": True} | {reason: False})
    gap, parts = (0.04, 1.0) if reason == "jaw" else (0.02, 2.0)
    check = steady(Hand(gap=gap), parts * GRAVITY * MASS, settings)
    assert not check.decide()
    assert check.result is not None
    assert getattr(check.result, reason)


def test_what_the_acceleration_adds_is_taken_off() -> None:
    t = CONTROL_PERIOD * np.arange(20)
    for acceleration in (-3.0, 2.0):
        check = lift(Hand(), 0.1 + 0.5 * t + acceleration / 2 * t**2, np.full(20, MASS * (GRAVITY + acceleration)))
        check.decide()
        assert check.result is not None
        assert check.result.load == pytest.approx(1.0)


def test_only_the_last_readings_count() -> None:
    forces = np.append(np.full(12, 30.0), np.full(8, GRAVITY * MASS))  # other parts hold it back at first
    check = lift(Hand(), 0.1 + 0.01 * np.arange(20), forces)
    assert not check.decide()


def test_a_light_part_is_not_taken_for_two_where_the_sensor_is_poor() -> None:
    poor = DoubleSettings(force=WristForceNoise(noise=0.0, drift=0.5))
    assert poor.heaviest(MASS) == pytest.approx(GRAVITY * MASS + 1.0)
    assert QUIET.heaviest(MASS) == pytest.approx(1.5 * GRAVITY * MASS)


@pytest.mark.parametrize(
    ("drift", "parts", "undecided"),
    # 2.5 standard deviations are half a part's weight at 0.2 parts, and then nothing is undecided
    [(0.19, 1.5, False), (0.21, 1.5, True), (0.3, 1.2, False), (0.3, 1.3, True), (0.3, 1.7, True), (0.3, 1.8, False)],
)
def test_a_weight_that_may_be_of_one_part_and_of_two_is_undecided(drift: float, parts: float, undecided: bool) -> None:
    settings = DoubleSettings(force=WristForceNoise(noise=0.0, drift=drift * GRAVITY * MASS))
    check = steady(Hand(), parts * GRAVITY * MASS, settings)
    check.image_possible = True
    found = check.decide()
    assert check.needs_image is undecided
    assert found is (not undecided and parts > 1.5)  # the image is left to decide


@pytest.mark.parametrize(
    ("settings", "possible"), [({"image": False}, True), ({"weight": False}, True), ({}, False)], ids=str
)
def test_where_no_image_is_taken_the_weight_decides(settings: dict[str, bool], possible: bool) -> None:
    poor = DoubleSettings(force=WristForceNoise(noise=0.0, drift=0.3 * GRAVITY * MASS), **settings)
    check = steady(Hand(), 1.7 * GRAVITY * MASS, poor)
    check.image_possible = possible
    assert check.decide() is poor.weight
    assert not check.needs_image


@pytest.mark.parametrize("parts", [1.3, 2.0])
def test_where_an_image_shows_the_arm_the_weight_decides(parts: float) -> None:
    check = steady(Hand(), parts * GRAVITY * MASS)
    check.decide()
    assert not check.looked
    assert check.see(None) is (parts == 2.0)
    assert check.looked  # the time for the image was taken
    assert check.result is not None
    assert (check.result.gone, check.result.image) == (None, None)


@pytest.mark.parametrize(("drift", "told"), [(0.1, True), (0.3, False)])
def test_a_light_load_that_rests_is_not_told_from_noise(drift: float, told: bool) -> None:
    """2.5 standard deviations are half the weight of two parts at 0.4 parts of drift, and half of one at 0.2."""
    settings = DoubleSettings(force=WristForceNoise(noise=0.0, drift=drift * GRAVITY * MASS))
    check = steady(Hand(), GRAVITY * MASS, settings)
    check.decide()
    check._readings.extend([(0.0, 0.1)] * 3)
    assert check.lightened() is told


@pytest.mark.parametrize("wrong", [{"drop": 0.0}, {"second_drop": -0.1}, {"scale": 0.0}, {"scale": 1.1}], ids=str)
def test_heights_and_speeds_of_a_put_back_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"drop and second_drop must be positive and scale in \(0, 1\], got"):
        DoubleSettings(**wrong)


@pytest.mark.parametrize(("gone", "double"), [(-0.2, False), (0.49, False), (0.51, True)])
def test_what_an_image_shows_is_kept(gone: float, double: bool) -> None:
    check = steady(Hand(), 1.3 * GRAVITY * MASS)
    check.decide()
    assert check.result is not None
    assert (check.result.gone, check.result.image) == (None, None)
    assert check.see(gone) is double
    assert (check.result.gone, check.result.image, check.result.load) == (gone, double, pytest.approx(1.3))


@pytest.mark.parametrize(("carried", "held"), [((True, False), 1), ((True, True), 2), ((False, False), 0)])
def test_parts_that_rise_with_the_gripper_are_held(carried: tuple[bool, ...], held: int) -> None:
    check = steady(Hand(carried=carried), 1.0)
    check.decide()
    assert check.result is not None
    assert check.result.held == held


def test_a_load_that_rests_on_something_is_lighter_and_the_sensor_is_tared_first() -> None:
    hand = Hand()
    check = steady(hand, 2 * GRAVITY * MASS)
    check.decide()
    assert hand.tared == 1
    assert not check.lightened()
    hand.force = 0.4 * GRAVITY * MASS
    check.feel()
    assert not check.lightened()
    check.feel()
    check.feel()
    assert check.lightened()


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"readings": 0}, "readings must be at least 1, got 0"),
        ({"jaw_tolerance": 0.0}, "jaw_tolerance must be positive and deviations at least 0, got"),
        ({"deviations": -1.0}, "jaw_tolerance must be positive and deviations at least 0, got"),
        ({"sure": -1.0}, "sure must be at least 0 and most_gone positive, got"),
        ({"most_gone": 0.0}, "sure must be at least 0 and most_gone positive, got"),
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        DoubleSettings(**wrong)

"""The force at the wrist under a part that hangs in the jaw, and the errors of its readings."""

import numpy as np
import pytest

from binpick_env.cell.wrist_force import GRAVITY, WristForceNoise, WristForceSensor, carried_load
from tests.policies.hand_cell import HandCell, hand_cell

NONE = WristForceNoise(noise=0.0, drift=0.0)


@pytest.fixture(scope="module")
def hanging() -> HandCell:
    """Return a tee's cell in which the jaw holds the tee in the air."""
    cell = hand_cell("tee", 1)
    cell.lay(cell.flat())
    env, simulation = cell.env, cell.env.simulation
    plan = cell.picker.plan(cell.picker.grasps()[0])
    opening = cell.picker.gripper.control(plan.grasp.opening)  # type: ignore[union-attr]
    for q in plan.approach.q:  # type: ignore[union-attr]
        env.advance(np.append(q, opening).astype(np.float32))
    for _ in range(20):
        env.advance(np.append(simulation.target, 1.0).astype(np.float32))
    for q in plan.approach.q[:-30:-1]:  # type: ignore[union-attr]
        env.advance(np.append(q, 1.0).astype(np.float32))
    for _ in range(20):
        env.advance(np.append(simulation.target, 1.0).astype(np.float32))
    assert simulation.gripped() == {0}
    assert simulation.part_centres()[0, 2] > 0.05
    return cell


@pytest.mark.slow
def test_a_hanging_part_weighs_what_it_weighs(hanging: HandCell) -> None:
    simulation = hanging.env.simulation
    weight = GRAVITY * hanging.env.part.mass
    assert carried_load(simulation) == pytest.approx(weight, rel=0.05)
    assert WristForceSensor(simulation, NONE, np.random.default_rng(0)).read() == carried_load(simulation)


def test_readings_scatter_about_an_offset_that_taring_draws_anew(hanging: HandCell) -> None:
    simulation, noise = hanging.env.simulation, WristForceNoise(noise=0.3, drift=0.5)
    sensor = WristForceSensor(simulation, noise, np.random.default_rng(0))
    means = []
    for _ in range(60):
        sensor.tare()
        readings = np.array([sensor.read() for _ in range(60)]) - carried_load(simulation)
        assert readings.std() == pytest.approx(0.3, rel=0.4)
        means.append(readings.mean())
    assert np.std(means) == pytest.approx(noise.deviation(60), rel=0.3)
    assert abs(np.mean(means)) < 0.2


def test_averaging_lessens_the_noise_and_not_the_drift() -> None:
    noise = WristForceNoise(noise=0.4, drift=0.3)
    assert noise.deviation(1) == pytest.approx(0.5)
    assert noise.deviation(10_000) == pytest.approx(0.3, abs=1e-4)


@pytest.mark.parametrize("wrong", [{"noise": -0.1}, {"drift": -1.0}, {"noise": np.nan}])
def test_noise_must_not_be_negative(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="noise and drift must be at least 0 N"):
        WristForceNoise(**wrong)

"""The time-of-flight sensor: the figures of its preset on planes, steps and a corner."""

import numpy as np
import pytest

from binpick_env.camera.time_of_flight import TimeOfFlightModel
from tests.binpick_env.camera.test_sensor import plane, step
from tests.binpick_env.camera.test_stereo import view

QUIET = TimeOfFlightModel(sigma_z=0.0, multipath=0.0)


def noise(grey: int, z: float = 0.9) -> float:
    measured = TimeOfFlightModel().measure(view(plane(z), grey), np.random.default_rng(0))
    return float((measured.astype(np.float64) - z).std())


def test_noise_is_1_2_mm_and_grows_with_depth_and_on_dark_surfaces() -> None:
    assert noise(150) == pytest.approx(0.0012, rel=0.05)
    assert noise(150, 1.8) / noise(150) == pytest.approx(2.0, rel=0.05)
    assert noise(37) / noise(150) == pytest.approx(2.0, rel=0.05)


def test_flying_pixels_lie_between_foreground_and_background() -> None:
    measured = QUIET.measure(view(step(0.8, 0.9)), np.random.default_rng(0))
    flying = ((measured > 0.805) & (measured < 0.895)).sum(axis=1)
    assert flying.min() >= 3
    assert flying.max() <= 8
    assert np.all(np.abs(measured[:, :300] - 0.8) < 1e-5)


def test_multipath_pulls_a_concave_corner_nearer_and_leaves_a_plane() -> None:
    depth, normals = plane(0.9)
    valley = (0.9 - 0.0005 * np.abs(np.arange(640) - 320) * np.ones((480, 1))).astype(np.float32)
    sensor = TimeOfFlightModel(sigma_z=0.0, footprint=0.0)
    bent = sensor.measure(view((valley, normals)), np.random.default_rng(0)) - valley
    assert -0.003 <= bent[240, 320] < -0.0005
    assert np.all(np.abs(bent[100:380, 100:200]) < 5e-4)
    flat = sensor.measure(view((depth, normals)), np.random.default_rng(0))
    np.testing.assert_allclose(flat, 0.9, atol=1e-5)


def test_nothing_comes_from_nothing_or_from_the_dark() -> None:
    depth, normals = step(0.8, 0.9)
    depth[:, :50] = 0
    one, two = (TimeOfFlightModel().measure(view((depth, normals)), np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.dtype == np.float32
    assert np.all(one[depth == 0] == 0)
    assert not TimeOfFlightModel().measure(view((depth, normals), 9), np.random.default_rng(3)).any()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"reference": 0}, "reference must be positive, got 0"),
        ({"sigma_z": -1}, "sigma_z must not be negative, got -1"),
        ({"multipath": 2}, r"multipath must be in \[0, 1\], got 2"),
        ({"max_incidence": 2}, r"max_incidence must be in \(0, pi / 2\], got 2"),
    ],
)
def test_mistakes_are_named(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TimeOfFlightModel(**values)

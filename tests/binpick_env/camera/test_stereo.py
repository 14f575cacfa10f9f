"""The active-stereo sensor: the figures of its preset on planes and steps."""

import numpy as np
import pytest

from binpick_env.camera.depth_sensor import TrueView
from binpick_env.camera.stereo import StereoModel
from tests.binpick_env.camera.test_sensor import K, plane, step

QUIET = StereoModel(subpixel=0.0, dark=0.0, glint_loss=0.0)


def view(scene: tuple[np.ndarray, np.ndarray], grey: int = 150) -> TrueView:
    return TrueView(depth=scene[0], normals=scene[1], grey=np.full(scene[0].shape, grey, np.uint8), K=K)


def disparity_error(z: float) -> np.ndarray:
    measured = StereoModel(glint_loss=0.0).measure(view(plane(z)), np.random.default_rng(0)).astype(np.float64)
    return np.asarray(measured - z)[:, 100:]  # past the columns whose shadow falls out of the image


def test_sigma_is_1_2_mm_at_0_9_m_and_grows_with_the_square_of_depth() -> None:
    assert StereoModel().sigma_z(0.9) == pytest.approx(0.00117, abs=1e-5)
    near, far = disparity_error(0.9).std(), disparity_error(1.8).std()
    assert near == pytest.approx(0.00117, rel=0.05)
    assert far / near == pytest.approx(4.0, rel=0.08)


def test_errors_are_correlated_over_3_px() -> None:
    error = disparity_error(0.9)
    assert np.corrcoef(error[:, 3:].ravel(), error[:, :-3].ravel())[0, 1] > 0.5
    assert abs(np.corrcoef(error[:, 15:].ravel(), error[:, :-15].ravel())[0, 1]) < 0.05


def test_disparities_are_multiples_of_a_32nd_of_a_pixel() -> None:
    measured = StereoModel(glint_loss=0.0).measure(view(plane(0.9)), np.random.default_rng(0))
    steps = 1004.0 * 0.055 / measured[measured > 0].astype(np.float64) * 32
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)


def test_the_foreground_is_fattened_by_2_to_4_px_and_the_second_camera_misses_a_strip() -> None:
    near, far = 0.8, 0.9
    measured = QUIET.measure(view(step(near, far, high_first=False)), np.random.default_rng(0))
    grown = (np.abs(measured[:, :320] - near) < 0.01).sum(axis=1)
    assert grown.min() == 2
    assert grown.max() == 4
    missed = (measured[:, :320] == 0).sum(axis=1) + grown
    assert missed.min() >= K[0, 0] * 0.055 * (1 / near - 1 / far) - 1


@pytest.mark.parametrize(("grey", "share"), [(0, 1.0), (22, 0.51), (150, 0.0)])
def test_dark_surfaces_are_lost(grey: int, share: float) -> None:
    measured = StereoModel(glint_loss=0.0).measure(view(plane(0.9), grey), np.random.default_rng(0))
    assert (measured == 0).mean() == pytest.approx(share, abs=0.03)


def test_mirroring_and_grazing_surfaces_are_lost() -> None:
    sensor = StereoModel()
    facing = sensor.measure(view(plane(0.9)), np.random.default_rng(0)) == 0
    middle = np.s_[200:280, 280:360]
    assert facing[middle].mean() == pytest.approx(sensor.glint_loss, abs=0.1)
    assert np.all(sensor.measure(view(plane(0.9, np.deg2rad(-75))), np.random.default_rng(0)) == 0)


def test_nothing_comes_from_nothing_and_a_seed_gives_the_same_bits() -> None:
    depth, normals = step(0.8, 0.9)
    depth[:, :50] = 0
    one, two = (StereoModel().measure(view((depth, normals)), np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.dtype == np.float32
    assert np.all(one[depth == 0] == 0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"focal": 0}, "focal must be positive, got 0"),
        ({"subpixel": -1}, "subpixel must not be negative, got -1"),
        ({"baseline": 0}, "baseline must be within 1 m and not 0, got 0"),
        ({"fattening": -1}, "fattening must not be negative, got -1"),
        ({"max_incidence": 2}, r"max_incidence must be in \(0, pi / 2\], got 2"),
        ({"glint_loss": 2}, r"glint_loss must be in \[0, 1\], got 2"),
    ],
)
def test_mistakes_are_named(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StereoModel(**values)  # type: ignore[arg-type]

"""Pictures of frames without a grey image show the shaded depth."""

from dataclasses import replace

import numpy as np
import pytest

from perception.frame import Frame
from perception.geometry import camera_matrix
from policies.frames.shading import shade_depth, shown_grey

K = camera_matrix(150.0, 96, 80)


def test_a_grey_image_is_shown_as_it_is_and_the_shaded_depth_without_one() -> None:
    depth = np.full((80, 96), 0.9, np.float32)
    frame = Frame(grey=np.arange(7680).reshape(80, 96).astype(np.uint8), depth=depth, K=K, T_world_cam=np.eye(4))
    assert shown_grey(frame) is frame.grey
    np.testing.assert_array_equal(shown_grey(replace(frame, grey=None)), shade_depth(depth, K))  # type: ignore[arg-type]


def test_a_plane_has_one_shade() -> None:
    flat = shade_depth(np.full((80, 96), 0.9, np.float32), K)
    assert np.ptp(flat) == 0
    assert flat[0, 0] == round(30 + 220 * 0.77 / np.sqrt(0.16 + 0.25 + 0.77**2))


def test_slopes_towards_the_light_are_brighter() -> None:
    v, u = np.mgrid[:80, :96]
    left, right = (shade_depth((0.9 + s * 0.002 * u + 0 * v).astype(np.float32), K) for s in (-1, 1))
    top, bottom = (shade_depth((0.9 + s * 0.002 * v + 0 * u).astype(np.float32), K) for s in (-1, 1))
    assert left.mean() > right.mean()  # a surface that comes nearer towards the right faces left, to the light
    assert top.mean() > bottom.mean()


@pytest.mark.parametrize("shape", [(80, 96), (1, 5)])
def test_without_depth_there_is_nothing_to_shade(shape: tuple[int, int]) -> None:
    assert not shade_depth(np.zeros(shape, np.float32), K).any()


@pytest.mark.parametrize("shape", [(80, 96), (3, 2)])
def test_depth_between_the_rows_that_tell_the_noise_is_shaded(shape: tuple[int, int]) -> None:
    depth = np.zeros(shape, np.float32)
    depth[1::4] = 0.9
    assert shade_depth(depth, K).min() > 150  # a plane


def test_absurdly_small_depths_are_shaded() -> None:
    assert shade_depth(np.full((80, 96), 1e-30, np.float32), K).shape == (80, 96)


def test_creases_are_shaded_as_their_normals_say() -> None:
    # A roof: the left half faces left by 30 degrees, the right half right; their rays meet planes x tan + z = const.
    u = np.broadcast_to(np.arange(96.0), (80, 96))
    slope = np.tan(np.radians(30))
    x = (u - K[0, 2]) / K[0, 0]
    depth = 0.9 / (1 - slope * np.abs(x))  # z = 0.9 + tan(30 deg) |X|, X = x z
    shaded = shade_depth(depth.astype(np.float32), K)
    light = np.array([-0.4, -0.5, -0.77]) / np.linalg.norm([-0.4, -0.5, -0.77])
    for column, sign in ((20, -1), (76, 1)):
        normal = np.array([sign * np.sin(np.radians(30)), 0, -np.cos(np.radians(30))])
        wanted = 30 + 220 * max(normal @ light, 0) * np.cos(np.radians(30))
        assert abs(float(shaded[40, column]) - wanted) <= 1


@pytest.mark.parametrize("sigma", [0.0002, 0.001])
def test_steps_are_dark_and_noise_is_smoothed(sigma: float) -> None:
    rng = np.random.default_rng(0)
    depth = 0.9 + rng.normal(0, sigma, (240, 320))
    depth[100:150, 120:180] -= 0.05
    depth[10:20, 30:50] = 0
    shaded = shade_depth(depth.astype(np.float32), camera_matrix(400.0, 320, 240)).astype(float)
    assert shaded[99:101, 130:170].max() < 80
    assert shaded[110:140, 119:121].max() < 80
    floor = shaded[160:230, 20:300]
    assert floor.mean() == pytest.approx(198, abs=4)  # the shade of a plane
    assert floor.std() < 10

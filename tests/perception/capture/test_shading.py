"""Boundaries are found in shaded depth, where an image of zeros has none."""

import numpy as np
import pytest
from numpy.typing import NDArray

from perception.boundary import extract_boundary
from perception.capture.shading import fill_from_nearest, shade_depth
from perception.frame import Frame, Workspace
from perception.geometry import camera_matrix, make_transform, rotation_about

K = camera_matrix(150.0, 96, 80)
T_CAM_BIN = make_transform(rotation_about((1, 0, 0), np.pi), (0, 0, 0.9))


def box_depth(holes: bool = False) -> NDArray[np.float32]:
    """Return a view from 0.9 m on a flat floor with a box of 50 mm on it."""
    depth = np.full((80, 96), 0.9, np.float32)
    depth[30:50, 40:60] = 0.85
    if holes:
        depth[10:14, 70:76] = 0
    return depth


def boundary_pixels(grey: NDArray[np.uint8], depth: NDArray[np.float32]) -> NDArray[np.int64]:
    workspace = Workspace(T_world_bin=T_CAM_BIN, inner_size=np.array([0.5, 0.4, 0.1]))
    frame = Frame(grey=grey, depth=depth, K=K, T_world_cam=np.eye(4))
    return extract_boundary(frame, workspace).pixels


def test_the_boundary_of_a_box_is_found_in_shaded_depth() -> None:
    depth = box_depth(holes=True)
    pixels = boundary_pixels(shade_depth(depth, K), depth)
    assert len(pixels) > 60
    assert ((pixels >= (40, 30)) & (pixels < (60, 50))).all()
    for side in (pixels[:, 0] < 44, pixels[:, 0] > 55, pixels[:, 1] < 34, pixels[:, 1] > 45):
        assert np.count_nonzero(side) > 15


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


def test_holes_take_the_nearest_grey() -> None:
    image = np.array([[1, 0, 0, 9]], np.uint8)
    assert fill_from_nearest(image, image > 0).tolist() == [[1, 1, 9, 9]]
    assert fill_from_nearest(image, np.ones((1, 4), bool)) is image


def test_noise_draws_few_edges_and_steps_stay_on_their_pixels() -> None:
    rng = np.random.default_rng(0)
    depth = np.full((240, 320), 0.9) + rng.normal(0, 0.0015, (240, 320))
    depth[100:150, 120:180] -= 0.03
    K_large = camera_matrix(400.0, 320, 240)
    workspace = Workspace(T_world_bin=T_CAM_BIN, inner_size=np.array([0.6, 0.5, 0.1]))
    clean = depth.astype(np.float32)
    frame = Frame(grey=shade_depth(clean, K_large), depth=clean, K=K_large, T_world_cam=np.eye(4))
    pixels = extract_boundary(frame, workspace).pixels
    outline = np.zeros((240, 320), bool)
    outline[98:152, 118:182] = True
    outline[103:147, 123:177] = False
    on_outline = outline[pixels[:, 1], pixels[:, 0]]
    assert np.count_nonzero(on_outline) > 200  # of a perimeter of 220
    assert np.count_nonzero(~on_outline) < 0.1 * np.count_nonzero(on_outline)

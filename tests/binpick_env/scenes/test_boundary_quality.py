"""Which points lie on the wrong side of a contour, by hand."""

import numpy as np

from binpick_env.camera.depth_camera import Capture
from binpick_env.scenes.boundary_quality import wrong_side
from perception.boundary import BoundaryCloud
from perception.frame import Frame
from perception.geometry import camera_matrix

SHAPE = (12, 20)


def capture() -> Capture:
    """Return a floor at 0.9 m with part 0 at 0.88 m from column 10 and part 1, 2 mm over the floor, below row 8."""
    depth, ids = np.full(SHAPE, 0.9, np.float32), np.full(SHAPE, -1, np.int64)
    depth[8:], ids[8:] = 0.898, 1
    depth[:, 10:], ids[:, 10:] = 0.88, 0
    frame = Frame(grey=np.zeros(SHAPE, np.uint8), depth=depth, K=camera_matrix(50.0, 20, 12), T_world_cam=np.eye(4))
    return Capture(
        frame=frame,
        instance_ids=ids,
        measured_ids=ids,
        depth_true=depth,
        normals=np.zeros((*SHAPE, 3), np.float32),
        region=(0, 0, SHAPE[1], SHAPE[0]),
        T_world_cam=np.eye(4),
    )


def at(*pixels: tuple[int, int]) -> BoundaryCloud:
    count = len(pixels)
    return BoundaryCloud(
        points_cam=np.ones((count, 3)),
        tangents_cam=np.zeros((count, 3)),
        linearity=np.zeros(count),
        pixels=np.array(pixels, np.int64).reshape(-1, 2),
    )


def test_a_point_of_the_nearer_surface_is_right_and_one_behind_it_wrong() -> None:
    assert wrong_side(capture(), at((10, 3))) == (0, 1)
    assert wrong_side(capture(), at((9, 3))) == (1, 1)


def test_the_patch_reaches_two_pixels() -> None:
    assert wrong_side(capture(), at((8, 3))) == (1, 1)
    assert wrong_side(capture(), at((7, 3))) == (0, 0)
    assert wrong_side(capture(), at((11, 3))) == (0, 1)
    assert wrong_side(capture(), at((12, 3))) == (0, 0)
    assert wrong_side(capture(), at((2, 6))) == (0, 1)
    assert wrong_side(capture(), at((2, 5))) == (0, 0)


def test_a_step_of_less_than_three_millimetres_has_no_wrong_side() -> None:
    assert wrong_side(capture(), at((2, 7), (2, 8))) == (0, 2)


def test_a_step_within_one_part_is_no_contour() -> None:
    seen = capture()
    seen.instance_ids[:] = 0
    assert wrong_side(seen, at((9, 3))) == (0, 0)


def test_the_images_border_and_pixels_without_truth_do_no_harm() -> None:
    seen = capture()
    corners = at((0, 0), (19, 0), (0, 11), (19, 11))
    assert wrong_side(seen, corners) == (0, 0)
    seen.depth_true[:, 10:] = 0.0
    assert wrong_side(seen, at((9, 3))) == (0, 1)


def test_a_cloud_is_the_sum_of_its_points() -> None:
    assert wrong_side(capture(), at((9, 3), (10, 3), (5, 3), (8, 9), (2, 7))) == (2, 4)
    assert wrong_side(capture(), at()) == (0, 0)

"""The owner of a measured depth: the part whose surface has that depth, also where a sensor puts it beside the part."""

import numpy as np
import pytest

from binpick_env.camera._image_kernels import owners_of_depth
from binpick_env.config import CameraConfig
from binpick_env.scenes.synthesis import SceneConfig, make_scene

TRUE = np.array([[0.80, 0.80, 0.85, 0.85, 0.90, 0.90, 0.90, 0.0]], np.float32)
IDS = np.array([[3, 3, 5, 5, -1, -1, -1, -1]])


@pytest.mark.parametrize(
    ("measured", "owners"),
    [
        (TRUE[0], IDS[0]),
        (TRUE[0] + np.float32(0.004) * (TRUE[0] > 0), IDS[0]),  # noise
        ([0.80, 0.80, 0.80, 0.85, 0.85, 0.85, 0.90, 0.0], [3, 3, 3, 5, 5, 5, -1, -1]),  # what is in front is fattened
        ([0.80, 0.82, 0.85, 0.87, 0.90, 0.90, 0.90, 0.0], [3, -1, 5, -1, -1, -1, -1, -1]),  # flying pixels
        (
            [0.00, 0.80, 0.85, 0.85, 0.90, 0.90, 0.90, 0.9],
            [-1, 3, 5, 5, -1, -1, -1, -1],
        ),  # holes, and too much
        ([0.80, 0.80, 0.85, 0.85, 0.90, 0.90, 0.80, 0.0], [3, 3, 5, 5, -1, -1, -1, -1]),  # too far away to be part 3
    ],
)
def test_depths_belong_to_the_nearest_surface_that_fits(measured: list[float], owners: list[int]) -> None:
    depth = np.array([measured], np.float32)
    np.testing.assert_array_equal(owners_of_depth(depth, TRUE, IDS, 0.005, 4), [owners])
    turned = owners_of_depth(np.ascontiguousarray(depth.T), np.ascontiguousarray(TRUE.T), IDS.T.copy(), 0.005, 4)
    np.testing.assert_array_equal(turned[:, 0], owners)


def test_points_of_a_scene_are_labelled_by_their_surface() -> None:
    shared = {"part": "part_c", "num_parts": (4, 4), "camera": CameraConfig(width=480, height=360)}
    scene, capture = make_scene(SceneConfig(sensor="good", **shared), 0)
    assert capture.measured_ids is capture.instance_ids
    scene, capture = make_scene(SceneConfig(sensor="stereo", **shared), 0)
    u, v = scene.boundary.pixels.T
    moved = np.abs(scene.boundary.points_cam[:, 2] - capture.depth_true[v, u]) > 0.01
    assert moved.sum() > 50
    assert (capture.instance_ids[v, u] < 0)[moved].mean() > 0.5  # the pixel shows the floor
    assert (scene.instance_ids >= 0)[moved].mean() > 0.5  # the depth is a part's, or the bin's wall's

"""Kernels of motion planning against plain loops."""

import numpy as np

from perception.geometry import make_transform, random_rotation, rotation_about
from policies.motion._kernels import box_heights, place_points
from tests.reference import height_twin as twin


def test_points_are_placed_by_each_transform() -> None:
    rng = np.random.default_rng(3)
    T = np.stack([make_transform(random_rotation(rng), rng.normal(size=3)) for _ in range(7)])
    points = rng.normal(size=(11, 3))
    expected = np.einsum("sij,pj->spi", T[:, :3, :3], points) + T[:, None, :3, 3]
    np.testing.assert_allclose(place_points(T, points), expected.reshape(-1, 3), rtol=0, atol=1e-14)
    assert place_points(T, points[:0]).shape == (0, 3)


def test_the_highest_box_counts() -> None:
    rng = np.random.default_rng(4)
    turns = np.stack([rotation_about((0, 0, 1), angle).ravel() for angle in (0.0, 0.7, np.pi / 2, -1.2)])
    places, sizes = rng.uniform(-0.1, 0.1, (4, 3)), rng.uniform(0.02, 0.1, (4, 3))
    points = rng.uniform(-0.3, 0.3, (500, 3))
    found = box_heights(points, places, turns, sizes)
    np.testing.assert_array_equal(found, twin.box_heights(points, places, turns, sizes))
    assert len(np.unique(found)) == 5  # each box, and none

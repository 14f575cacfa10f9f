"""Kernels of the grasp planner against plain loops, bit for bit."""

import numpy as np
import pytest
import trimesh

from perception.geometry import Floats, camera_matrix, make_transform, random_rotation, rotation_about
from policies.grasping._kernels import fill_solid, raise_cells, raise_cells_from_depth
from tests.reference import height_twin as twin

ORIGIN = np.array([-0.05, -0.03])


def low() -> Floats:
    """Return a map of 25 x 15 cells that are as low as can be."""
    return np.full((25, 15), -np.inf)


def test_a_solid_is_filled_voxel_by_voxel() -> None:
    rng = np.random.default_rng(2)
    half, shape, voxel = np.array([0.011, 0.007, 0.015]), (41, 43, 45), 0.001
    origin = np.array([-0.02, -0.021, -0.022]) + 0.0003
    index = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1)
    for _ in range(3):
        T = make_transform(random_rotation(rng), rng.uniform(-0.002, 0.002, 3))
        solid = trimesh.creation.box(2 * half, T)
        occupied = np.zeros(shape, np.bool_)
        fill_solid(np.ascontiguousarray(solid.triangles), origin, voxel, occupied)
        local = (origin + voxel * index - T[:3, 3]) @ T[:3, :3]
        np.testing.assert_array_equal(occupied, np.all(np.abs(local) < half, axis=-1))


@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 1000])
def test_points_raise_the_cells_they_lie_over(count: int) -> None:
    rng = np.random.default_rng(count)
    T = make_transform(random_rotation(rng), rng.uniform(-0.02, 0.02, 3))
    points, raised = rng.uniform(-0.06, 0.06, (count, 3)), low()
    raise_cells(raised, ORIGIN, 0.004, points, T)
    expected = twin.raise_cells(low(), ORIGIN, 0.004, points, T)
    np.testing.assert_array_equal(raised, expected)
    assert np.isneginf(raised).any()  # some points fall beside the map
    higher = raised.copy()
    raise_cells(higher, ORIGIN, 0.004, points - T[2, :3], T)  # straight down
    np.testing.assert_array_equal(higher, twin.raise_cells(raised, ORIGIN, 0.004, points - T[2, :3], T))


@pytest.mark.parametrize("stride", [1, 2, 5])
def test_pixels_raise_the_cells_they_see(stride: int) -> None:
    rng = np.random.default_rng(stride)
    depth = rng.uniform(0.8, 0.9, (23, 41)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0.0
    K = camera_matrix(300.0, 41, 23)
    T = make_transform(rotation_about((1, 0, 0), 3.0) @ rotation_about((0, 0, 1), 0.3), (0.0, 0.1, 0.9))
    raised = low()
    raise_cells_from_depth(raised, ORIGIN, 0.004, depth, K, T, stride)
    np.testing.assert_array_equal(raised, twin.raise_cells(low(), ORIGIN, 0.004, twin.points_of(depth, K, stride), T))
    assert np.isfinite(raised).sum() > 20 / stride


def test_a_pixel_without_depth_and_a_point_that_is_no_number_raise_nothing() -> None:
    raised = low()
    raise_cells_from_depth(
        raised, ORIGIN, 0.004, np.zeros((4, 6), np.float32), camera_matrix(9.0, 6, 4), make_transform(), 1
    )
    raise_cells(raised, ORIGIN, 0.004, np.array([[np.nan, 0.0, 0.0], [0.0, 0.0, np.nan]]), make_transform())
    assert np.isneginf(raised).all()

"""The coarse surface: plates worked out by hand, and the compiled kernel against its plain twin."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.geometry import Floats, invert_transform, make_transform, project_points, transform_points
from perception.segmentation import _surface_kernels as _kernels
from perception.segmentation.surface import CELLS_PER_D_MAX, Surface, coarse_surface
from tests.perception.flat_scene import FLOOR, INNER, SIZE, TILTED, K, bin_at, camera_over, flat, look
from tests.reference import boundary_twin

D_MAX = 0.32  # large, so that a cell holds several of the few pixels
WORKSPACE = bin_at(0.3, (0.5, 0.1, 0.02))
STRAIGHT = camera_over(WORKSPACE)


def test_a_cell_is_an_eightieth_of_the_part_on_the_floor() -> None:
    surface = coarse_surface(look(WORKSPACE, STRAIGHT, FLOOR), WORKSPACE, D_MAX)
    assert surface.cell == pytest.approx(D_MAX / CELLS_PER_D_MAX * K[0, 0] / 0.9)
    np.testing.assert_allclose(surface.depth, 0.9, atol=1e-6)
    assert surface.depth.dtype == np.float32


def test_in_a_small_image_a_cell_is_a_pixel_and_none_is_empty() -> None:
    surface = coarse_surface(look(WORKSPACE, STRAIGHT, FLOOR), WORKSPACE, 0.1)
    assert surface.cell == 1.0
    np.testing.assert_allclose(surface.depth, 0.9, atol=1e-6)


@pytest.mark.parametrize("turn", [np.eye(3), np.diag([1.0, -1, -1])])
def test_a_bin_stated_at_the_camera_shows_nothing(turn: Floats) -> None:
    frame = look(WORKSPACE, STRAIGHT, FLOOR)
    T_world_bin = STRAIGHT @ make_transform(turn, (0, 0, 0))
    depth = coarse_surface(frame, replace(WORKSPACE, T_world_bin=T_world_bin), D_MAX).depth
    assert depth.size <= 1


def test_the_cells_cover_the_bin() -> None:
    T_world_cam = camera_over(WORKSPACE, TILTED)
    surface = coarse_surface(look(WORKSPACE, T_world_cam, FLOOR), WORKSPACE, D_MAX)
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]) * INNER / 2
    T_cam_bin = invert_transform(T_world_cam) @ WORKSPACE.T_world_bin
    pixels = project_points(K, transform_points(T_cam_bin, corners)).clip(0, np.array(SIZE) - 1)
    cells = (pixels - (surface.u0, surface.v0)) / surface.cell
    assert cells.min() >= 0
    assert (cells <= np.array(surface.depth.shape[::-1])).all()
    assert (surface.depth > 0).mean() > 0.9


def test_a_cell_across_an_edge_shows_the_nearer_surface_alone() -> None:
    plate = flat(0.06, -0.03, 0.05, (0.08, 0.05))
    surface = coarse_surface(look(WORKSPACE, STRAIGHT, FLOOR, plate), WORKSPACE, D_MAX)
    near = surface.depth < 0.875
    np.testing.assert_allclose(surface.depth[near], 0.85, atol=1e-6)
    np.testing.assert_allclose(surface.depth[~near], 0.9, atol=1e-6)
    rows, columns = np.nonzero(near)
    corners = np.array([(x, y, 0.0) for x in (-0.04, 0.04) for y in (-0.025, 0.025)])
    T_cam_plate = invert_transform(STRAIGHT) @ WORKSPACE.T_world_bin @ plate.T_bin_plate
    u, v = project_points(K, transform_points(T_cam_plate, corners)).T
    assert surface.u0 + surface.cell * columns.min() == pytest.approx(u.min(), abs=surface.cell + 1)
    assert surface.u0 + surface.cell * (columns.max() + 1) == pytest.approx(u.max(), abs=surface.cell + 1)
    assert surface.v0 + surface.cell * rows.min() == pytest.approx(v.min(), abs=surface.cell + 1)
    assert surface.v0 + surface.cell * (rows.max() + 1) == pytest.approx(v.max(), abs=surface.cell + 1)


def test_where_nothing_was_measured_is_zero() -> None:
    frame = look(WORKSPACE, STRAIGHT, FLOOR)
    depth = frame.depth.copy()
    depth[:, :150] = np.nan
    surface = coarse_surface(replace(frame, depth=depth), WORKSPACE, D_MAX)
    border = (150 - surface.u0) / surface.cell
    assert border > 2
    np.testing.assert_array_equal(surface.depth[:, : int(border)], 0.0)
    np.testing.assert_allclose(surface.depth[:, int(np.ceil(border)) :], 0.9, atol=1e-6)


def test_a_bin_out_of_view_has_no_cells() -> None:
    beside = replace(WORKSPACE, T_world_bin=make_transform(translation=(5.0, 0.0, 0.0)) @ WORKSPACE.T_world_bin)
    assert coarse_surface(look(WORKSPACE, STRAIGHT, FLOOR), beside, 0.4).depth.size == 0


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_nearest_surface_equals_its_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = rng.integers(1, 14, size=2)
    depth = rng.choice([0.9, 0.899, 0.85], size=shape) + rng.normal(0, 5e-4, shape)
    depth[rng.random(shape) < rng.choice([0.0, 0.5, 1.0])] = 0.0
    u0, v0 = (int(x) for x in rng.integers(0, 6, size=2))
    cell = float(rng.choice([0.5, 0.7, 1.0, 2.5, 3.0, 5.3]))
    cells = int(rng.integers(0, 7)), int(rng.integers(0, 7))
    arguments = depth.astype(np.float32), u0, v0, cell, cells, 0.003
    np.testing.assert_allclose(
        _kernels.nearest_surface(*arguments), boundary_twin.nearest_surface(*arguments), atol=1e-6
    )


def test_nonsense_is_refused() -> None:
    frame = look(WORKSPACE, STRAIGHT, FLOOR)
    for d_max in (0.0, -0.1, np.nan):
        with pytest.raises(ValueError, match=f"d_max must be positive, got {d_max}"):
            coarse_surface(frame, WORKSPACE, d_max)
    text = r"a part of d_max 0\.1 mm is 0 px long at the bin's floor, 0\.\d+ m from the camera; at least 40 px are"
    with pytest.raises(ValueError, match=text):
        coarse_surface(frame, WORKSPACE, 0.0001)
    with pytest.raises(
        ValueError, match=r"a part of d_max 92000 mm does not fit into a bin of \d+ x \d+ x \d+ mm .* metres\?\)"
    ):
        coarse_surface(frame, WORKSPACE, 92.0)
    with pytest.raises(ValueError, match=r"depth must be \(N, N\), got \(3,\)"):
        Surface(depth=np.zeros(3, np.float32), u0=0.0, v0=0.0, cell=1.0)
    for cell in (0.0, np.nan):
        with pytest.raises(ValueError, match=f"cell must be positive, got {cell}"):
            Surface(depth=np.zeros((1, 1), np.float32), u0=0.0, v0=0.0, cell=cell)

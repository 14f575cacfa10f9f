"""Depth edges of surfaces worked out by hand."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from perception import _depth_edge_kernels as kernels
from perception.boundary import BoundarySettings, extract_boundary
from perception.depth_edges import DepthEdgeSettings, depth_edges, depth_noise, depth_std, depth_step, sampled_rows
from perception.frame import Frame, Workspace
from perception.geometry import camera_matrix, make_transform, rotation_about
from tests.perception.flat_scene import FLOOR, K, Plate, bin_at, camera_over, flat, look
from tests.perception.test_boundary import PIXEL, PLATE, inward, missed, on_plate, seen
from tests.reference import depth_edges_twin

WIDE = camera_matrix(1200.0, 160, 120)
SIGMA = 0.0003  # of a good sensor [m]


def plane(right: float = 0.0, *, noise: float = 0.0, seed: int = 0, correlation: float = 0.0) -> np.ndarray:
    """Return the depth of a plane whose right half is nearer by ``right`` [m], with noise of some correlation [px]."""
    depth = np.full((120, 160), 0.9)
    depth[:, 80:] -= right
    errors = np.random.default_rng(seed).normal(size=depth.shape)
    if correlation:
        errors = cv2.GaussianBlur(errors, (0, 0), correlation)
        errors /= errors.std()
    return (depth + noise * errors).astype(np.float32)


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_a_step_is_a_line_on_the_near_side(turn: int) -> None:
    """Turned by any number of right angles, it has the same pixels."""
    found = np.rot90(depth_edges(np.rot90(plane(0.01), turn).copy(), WIDE), -turn)
    assert found[:, 80].all()
    assert np.count_nonzero(found) == 120


@pytest.mark.parametrize("seed", range(3))
def test_a_step_of_four_times_the_noise_shows(seed: int) -> None:
    found = depth_edges(plane(4 * SIGMA, noise=SIGMA, seed=seed), WIDE)
    assert found[:, 78:82].any(axis=1).mean() > 0.5
    assert np.count_nonzero(found[:, :74]) + np.count_nonzero(found[:, 86:]) == 0


@pytest.mark.parametrize(("noise", "correlation"), [(0.0, 0.0), (SIGMA, 0.0), (0.0012, 1.2), (0.0012, 2.5)])
def test_noise_has_no_edges(noise: float, correlation: float) -> None:
    """The errors of a stereo camera are alike over several pixels."""
    assert not depth_edges(plane(noise=noise, correlation=correlation), WIDE).any()


def test_the_near_end_of_flying_pixels_is_the_edge() -> None:
    depth = plane(0.03)
    depth[:, 77:80] = [0.8925, 0.885, 0.8775]
    found = depth_edges(depth, WIDE)
    assert found[:, 80].all()
    assert np.count_nonzero(found) == 120


def test_a_step_across_missing_depth_is_an_edge() -> None:
    depth = plane(0.03)
    depth[:, 60:80] = 0
    found = depth_edges(depth, WIDE)
    assert found[:, 80].all()
    assert np.count_nonzero(found) == 120
    flat_one = plane()
    flat_one[40:60, 60:80] = 0
    assert not depth_edges(flat_one, WIDE).any()


def test_a_slope_is_no_edge() -> None:
    u = np.arange(160) - WIDE[0, 2]
    steep = 0.9 / (1 - np.tan(np.deg2rad(70)) * u / WIDE[0, 0])  # seen at 70 degrees
    assert not depth_edges(np.tile(steep, (120, 1)).astype(np.float32), WIDE).any()


@pytest.mark.parametrize("noise", [0.0, SIGMA])
def test_a_crease_is_a_line(noise: float) -> None:
    """A roof of two sides at 35 degrees."""
    u = np.abs(np.arange(160) - 80)
    depth = np.tile(0.9 + np.tan(np.deg2rad(35)) * u * 0.9 / WIDE[0, 0], (120, 1))
    depth += noise * np.random.default_rng(1).normal(size=depth.shape)
    found = depth_edges(depth.astype(np.float32), WIDE)
    assert found[:, 78:83].any(axis=1).mean() > 0.9
    assert np.count_nonzero(found[:, :72]) + np.count_nonzero(found[:, 88:]) == 0
    blunt = replace(DepthEdgeSettings(), crease=np.deg2rad(80), step=0.01)
    assert not depth_edges(depth.astype(np.float32), WIDE, blunt).any()


def test_specks_are_no_edges() -> None:
    depth = plane()
    depth[50, 60] = 0.8
    assert not depth_edges(depth, WIDE).any()
    assert depth_edges(depth, WIDE, DepthEdgeSettings(shortest=1)).any()


def test_the_noise_is_measured() -> None:
    assert depth_noise(plane(noise=0.001)) == pytest.approx(0.001 / 0.81, rel=0.05)
    assert depth_noise(plane()) == 0.0
    assert depth_std(plane(noise=0.001)) == pytest.approx(0.001, rel=0.05)
    assert depth_std(plane(noise=0.001), 8) == pytest.approx(0.001, rel=0.05)
    for measure in (depth_noise, depth_std):
        assert measure(np.zeros((5, 4), np.float32)) == 0.0


@pytest.mark.parametrize("unit", [1.0, 1000.0])
@pytest.mark.parametrize("step", [0.001, 0.003, 0.005])
def test_rounded_depth_has_at_least_the_noise_of_its_rounding(step: float, unit: float) -> None:
    slope = plane(noise=0.0003) + np.linspace(0, 0.15, 200, dtype=np.float32)[: plane().shape[1]]
    rounded = (np.rint(slope / step) * step * unit).astype(np.float32)
    assert depth_step(rounded.ravel()) == pytest.approx(step * unit, rel=1e-4)
    for lag in (3, 8):
        assert depth_std(rounded, lag) >= 0.99 * unit * step / np.sqrt(12)


def test_steps_of_disparity_few_levels_and_plain_floats_are_no_rounding() -> None:
    slope = plane(noise=0.0003) + np.linspace(0, 0.15, 200, dtype=np.float32)[: plane().shape[1]]
    disparity = (40 / np.rint(8 * 40 / slope) * 8).astype(np.float32)
    stairs = (np.rint(slope / 0.05) * 0.05).astype(np.float32)
    for depth in (slope, disparity, stairs, stairs[:0]):
        assert depth_step(depth.ravel()) == 0.0


@pytest.mark.parametrize("period", [2, 3, 4, 5])
def test_the_noise_is_measured_though_rows_or_columns_are_missing(period: int) -> None:
    depth = plane(noise=0.001)
    for lag in (3, 8):
        for kept in (np.arange(depth.shape[1]) % period == 1, np.arange(depth.shape[1]) % period != 1):
            assert depth_std(np.where(kept, depth, 0), lag) == pytest.approx(0.001, rel=0.15)
    rows = np.where(np.arange(len(depth))[:, None] % period == 1, depth, 0)
    assert depth_std(sampled_rows(rows, 8), 8) == pytest.approx(0.001, rel=0.15)
    assert np.array_equal(sampled_rows(depth, 8), depth[::8])


def test_nothing_is_found_where_nothing_is_measured() -> None:
    assert not depth_edges(np.zeros((20, 30), np.float32), WIDE).any()
    assert not depth_edges(np.eye(20, 30, dtype=np.float32), WIDE).any()


def test_the_line_fits_are_those_of_the_twin() -> None:
    depth = plane(0.004, noise=SIGMA)[:6]
    depth[:, 20:90:7] = 0
    depth[3, 100:125] = 0
    arguments = (depth, 1200.0, SIGMA / 0.81, 7, 4.0)
    expected = depth_edges_twin.row_deviations(*arguments)
    assert len(expected) > 500
    np.testing.assert_allclose(kernels.row_deviations(*arguments), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"step": 0.0}, "step must be positive, got 0.0"),
        ({"crease": -1.0}, "crease must be positive, got -1.0"),
        ({"reach": (3, 9)}, r"reach must be \(fewest, most\) pixels from 4 up, got \(3, 9\)"),
        ({"reach": (9, 8)}, r"got \(9, 8\)"),
        ({"shortest": 0}, "shortest must be at least 1 px, got 0"),
    ],
)
def test_nonsense_is_refused(change: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        DepthEdgeSettings(**change)


# --- boundary points -------------------------------------------------------------------------------------------------


def test_a_frame_without_a_grey_image_has_the_outlines_of_its_depth() -> None:
    frame, workspace = seen(PLATE, yaw=0.7)
    blind = Frame(depth=frame.depth, K=frame.K, T_world_cam=frame.T_world_cam)
    assert frame.has_grey
    assert not blind.has_grey
    cloud = extract_boundary(blind, workspace)
    assert cloud.source == cloud.only(np.arange(3)).source == "depth"
    aside = replace(workspace, T_world_bin=workspace.T_world_bin @ make_transform(translation=(5.0, 0.0, 0.0)))
    assert extract_boundary(blind, aside).source == "depth"  # nothing of the bin is in view
    points_plate = on_plate(frame, workspace, cloud.points_cam)
    np.testing.assert_allclose(points_plate[:, 2], 0.0, atol=1e-6)
    assert inward(points_plate).min() >= 0.0
    assert inward(points_plate).max() < 1.5 * PIXEL
    assert missed(points_plate).max() < 2.0 * PIXEL
    for other in (replace(frame, grey=None), replace(frame, grey=np.full_like(frame.grey, 90))):
        np.testing.assert_array_equal(extract_boundary(other, workspace).pixels, cloud.pixels)
    chosen = extract_boundary(frame, workspace, BoundarySettings(source="depth"))
    np.testing.assert_array_equal(chosen.pixels, cloud.pixels)


def test_the_boundary_of_a_box_with_holes_beside_it_is_its_outline() -> None:
    depth = np.full((80, 96), 0.9, np.float32)
    depth[30:50, 40:60] = 0.85
    depth[10:14, 70:76] = 0
    pixels = extract_boundary(
        Frame(depth=depth, K=camera_matrix(150.0, 96, 80), T_world_cam=np.eye(4)), bin_below((0.5, 0.4, 0.1))
    ).pixels
    assert len(pixels) > 60
    assert ((pixels >= (40, 30)) & (pixels < (60, 50))).all()
    for side in (pixels[:, 0] < 44, pixels[:, 0] > 55, pixels[:, 1] < 34, pixels[:, 1] > 45):
        assert np.count_nonzero(side) > 15


def test_noise_draws_few_boundary_points_and_steps_stay_on_their_pixels() -> None:
    depth = np.full((240, 320), 0.9) + np.random.default_rng(0).normal(0, 0.0015, (240, 320))
    depth[100:150, 120:180] -= 0.03
    frame = Frame(depth=depth.astype(np.float32), K=camera_matrix(400.0, 320, 240), T_world_cam=np.eye(4))
    pixels = extract_boundary(frame, bin_below((0.6, 0.5, 0.1))).pixels
    outline = np.zeros((240, 320), bool)
    outline[100:150, 120:180] = True
    outline[101:149, 121:179] = False
    seen_at = np.zeros(outline.shape, np.uint8)
    seen_at[pixels[:, 1], pixels[:, 0]] = 1
    near = cv2.dilate(outline.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert (cv2.dilate(seen_at, np.ones((5, 5), np.uint8))[outline] > 0).all()
    assert np.count_nonzero(seen_at) > 140  # noise puts several of the 216 on one pixel
    assert np.count_nonzero(seen_at[~near]) == 0


def bin_below(inner_size: tuple[float, float, float]) -> Workspace:
    """Return a bin whose floor is 0.9 m below a camera at the origin."""
    T = make_transform(rotation_about((1, 0, 0), np.pi), (0, 0, 0.9))
    return Workspace(T_world_bin=T, inner_size=np.array(inner_size))


def test_grey_and_depth_edges_complete_each_other() -> None:
    """A print on a plate shows in the grey image only, a plate as dark as the floor in the depth only."""
    workspace = bin_at()
    printed = (PLATE, flat(0.12, -0.04, 0.05001, (0.03, 0.02), 120))
    dark = flat(-0.1, 0.02, 0.04, (0.06, 0.05), FLOOR.grey)
    frame = look(workspace, camera_over(workspace), FLOOR, *printed, dark)
    pixels = {}
    for source in ("grey", "depth", "both"):
        cloud = extract_boundary(frame, workspace, BoundarySettings(source=source))
        assert cloud.source == source
        pixels[source] = {tuple(p) for p in cloud.pixels}
    middle = K[0, 2]
    assert not any(u < middle for u, _ in pixels["grey"])
    assert any(u < middle for u, _ in pixels["depth"])
    assert pixels["grey"] < pixels["both"]
    more = np.array(sorted(pixels["both"] - pixels["grey"]))
    assert more[:, 0].max() < middle  # the outline that both show is not doubled
    assert len(more) > 100


def test_a_ridge_shows_in_the_depth() -> None:
    workspace = bin_at()
    sides = [
        Plate(T_bin_plate=make_transform(rotation_about((0, 1, 0), s * 0.6), (s * 0.04, 0.0, 0.05)), size=(0.09, 0.1))
        for s in (-1, 1)
    ]
    frame = look(workspace, camera_over(workspace), FLOOR, *sides)
    cloud = extract_boundary(replace(frame, grey=None), workspace)
    points_bin = workspace.to_bin(cloud.points_cam @ frame.T_world_cam[:3, :3].T + frame.T_world_cam[:3, 3])
    on_ridge = (np.abs(points_bin[:, 0]) < 0.005) & (np.abs(points_bin[:, 1]) < 0.045)
    assert np.count_nonzero(on_ridge) > 30


def test_an_unknown_source_is_refused() -> None:
    with pytest.raises(ValueError, match="source must be one of grey, depth, both, got 'colour'"):
        BoundarySettings(source="colour")  # type: ignore[arg-type]

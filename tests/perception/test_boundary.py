"""Boundary points of scenes worked out by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perception.boundary import BoundaryCloud, BoundarySettings, extract_boundary, organised_points
from perception.frame import Frame, Workspace
from perception.geometry import (
    Floats,
    invert_transform,
    make_transform,
    project_points,
    rotation_about,
    transform_points,
)
from tests.perception.flat_scene import FLOOR, INNER, SIZE, TILTED, K, Plate, bin_at, camera_over, flat, look

PIXEL = 0.85 / K[0, 0]  # of a plate 5 cm over the floor [m]
PLATE = flat(0.12, -0.04, 0.05, (0.07, 0.05))
VIEWS = {"straight": (0.0, None), "turned": (0.7, None), "tilted": (-2.1, TILTED)}


def seen(*plates: Plate, yaw: float = 0.0, turn: Floats | None = None) -> tuple[Frame, Workspace]:
    """Return a frame of the bin's floor and ``plates``, and the bin, which stands somewhere in the world."""
    workspace = bin_at(yaw, (0.5, 0.1, 0.02))
    return look(workspace, camera_over(workspace, turn), FLOOR, *plates), workspace


def on_plate(frame: Frame, workspace: Workspace, points_cam: Floats, plate: Plate = PLATE) -> Floats:
    """Map camera points into the plate's frame."""
    T_plate_cam = invert_transform(workspace.T_world_bin @ plate.T_bin_plate) @ frame.T_world_cam
    return transform_points(T_plate_cam, points_cam)


def inward(points_plate: Floats, plate: Plate = PLATE) -> Floats:
    """Return how far inside the plate's outline each point lies, negative outside [m]."""
    return (np.array(plate.size) / 2 - np.abs(points_plate[:, :2])).min(axis=1)


def outline(plate: Plate = PLATE, step: float = 0.002) -> Floats:
    """Return (M, 3) points along the plate's four edges, plate frame."""
    x, y = np.array(plate.size) / 2
    across, along = np.arange(-x, x, step), np.arange(-y, y, step)
    return np.array(
        [(s, t * y, 0.0) for t in (-1, 1) for s in across] + [(s * x, t, 0.0) for s in (-1, 1) for t in along]
    )


def missed(points_plate: Floats, plate: Plate = PLATE) -> Floats:
    """Return the distance of each outline point to the nearest boundary point [m]."""
    line = outline(plate)
    return np.linalg.norm(line[:, None] - points_plate[None], axis=2).min(axis=1)


# --- a plate over a floor --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("view", VIEWS)
def test_the_points_are_the_plates_outline_and_not_the_floors(view: str) -> None:
    yaw, turn = VIEWS[view]
    frame, workspace = seen(PLATE, yaw=yaw, turn=turn)
    cloud = extract_boundary(frame, workspace)
    points_plate = on_plate(frame, workspace, cloud.points_cam)
    assert len(cloud) > 100
    np.testing.assert_allclose(points_plate[:, 2], 0.0, atol=1e-6)
    assert inward(points_plate).min() >= 0.0
    assert inward(points_plate).max() < 1.5 * PIXEL
    assert missed(points_plate).max() < 2.0 * PIXEL


@pytest.mark.parametrize("view", VIEWS)
def test_tangents_run_along_the_edges(view: str) -> None:
    yaw, turn = VIEWS[view]
    frame, workspace = seen(PLATE, yaw=yaw, turn=turn)
    cloud = extract_boundary(frame, workspace)
    points_plate = on_plate(frame, workspace, cloud.points_cam)
    R_plate_cam = (invert_transform(workspace.T_world_bin) @ frame.T_world_cam)[:3, :3]
    tangents_plate = cloud.tangents_cam @ R_plate_cam.T
    np.testing.assert_allclose(np.linalg.norm(cloud.tangents_cam, axis=1), 1.0)
    gap = np.array(PLATE.size) / 2 - np.abs(points_plate[:, :2])
    window = 12 * PIXEL  # beyond the corners' reach, at any turn of the window
    for axis, other in ((0, 1), (1, 0)):
        straight = (gap[:, axis] > window) & (gap[:, other] < 2 * PIXEL)
        assert straight.sum() > 10
        assert np.abs(tangents_plate[straight, axis]).min() > np.cos(np.deg2rad(4))
        assert cloud.linearity[straight].min() > 0.95
    corner = gap.max(axis=1) < 2 * PIXEL
    assert corner.sum() >= 4
    assert cloud.linearity[corner].max() < 0.8


def test_tangents_follow_a_slope_in_depth() -> None:
    ramp = Plate(T_bin_plate=make_transform(rotation_about((0, 1, 0), 0.6), (-0.05, 0.03, 0.06)), size=(0.1, 0.06))
    frame, workspace = seen(ramp, turn=TILTED)
    cloud = extract_boundary(frame, workspace)
    points_plate = on_plate(frame, workspace, cloud.points_cam, ramp)
    assert np.abs(points_plate[:, 2]).max() < 1e-6
    R_plate_cam = (invert_transform(workspace.T_world_bin @ ramp.T_bin_plate) @ frame.T_world_cam)[:3, :3]
    sloping = (np.abs(points_plate[:, 0]) < 0.035) & (np.abs(points_plate[:, 1]) > 0.026)
    assert sloping.sum() > 50
    tangents_plate = (cloud.tangents_cam @ R_plate_cam.T)[sloping]
    along = np.abs(tangents_plate[:, 0])
    assert along.min() > np.cos(np.deg2rad(12))  # steps of a pixel in a window that 3 mm of depth keep short
    assert np.median(along) > np.cos(np.deg2rad(6))
    # Without the slope in depth the tangents would lie across the optical axis, 0.5 rad off.
    assert np.abs(cloud.tangents_cam[sloping, 2]).min() > 0.3


def test_a_plate_on_a_plate_keeps_its_own_outline() -> None:
    below, above = flat(0.0, 0.0, 0.03, (0.12, 0.1), 140), flat(0.01, 0.01, 0.06, (0.05, 0.04), 220)
    frame, workspace = seen(below, above)
    cloud = extract_boundary(frame, workspace)
    height = 0.9 - cloud.points_cam[:, 2]
    assert set(np.round(height, 3)) == {0.03, 0.06}  # no point between two surfaces, none on the floor
    low = on_plate(frame, workspace, cloud.points_cam[height < 0.045], below)
    high = on_plate(frame, workspace, cloud.points_cam[height > 0.045], above)
    assert inward(low, below).max() < 1.5 * PIXEL
    assert inward(high, above).max() < 1.5 * PIXEL


# --- where depth is missing ------------------------------------------------------------------------------------------


def holed(frame: Frame, workspace: Workspace, half_width: int) -> Frame:
    """Take the depth from a band along the plate's edge at larger x: ``half_width`` px to either side, as NaN."""
    x, y = np.array(PLATE.size) / 2
    ends = transform_points(workspace.T_world_bin @ PLATE.T_bin_plate, np.array([(x, -y, 0), (x, y, 0)]))
    (u, _), _ = project_points(K, transform_points(invert_transform(frame.T_world_cam), ends))
    depth = frame.depth.copy()
    depth[:, int(np.round(u)) - half_width : int(np.round(u)) + half_width + 1] = np.nan
    return replace(frame, depth=depth)


def share_found(cloud: BoundaryCloud, frame: Frame, workspace: Workspace, reach: float) -> float:
    """Return the share of the edge at larger x, away from its ends, that has a point within ``reach``."""
    x, y = np.array(PLATE.size) / 2
    edge = np.array([(x, s, 0.0) for s in np.linspace(-0.3 * y, 0.3 * y, 20)])
    points_plate = on_plate(frame, workspace, cloud.points_cam)
    return float(np.mean(np.linalg.norm(edge[:, None] - points_plate, axis=2).min(axis=1) < reach))


def test_a_hole_along_the_edge_is_bridged_by_the_window() -> None:
    whole, workspace = seen(PLATE)
    frame = holed(whole, workspace, 3)
    cloud = extract_boundary(frame, workspace)
    assert share_found(cloud, frame, workspace, 5.5 * PIXEL) == 1.0
    assert np.abs(on_plate(frame, workspace, cloud.points_cam)[:, 2]).max() < 1e-6
    assert share_found(extract_boundary(whole, workspace), whole, workspace, 2 * PIXEL) == 1.0


def test_the_window_grows_no_further_than_it_may() -> None:
    frame, workspace = seen(PLATE)
    for half_width, chosen in ((3, BoundarySettings(widest=2)), (9, BoundarySettings())):
        holes = holed(frame, workspace, half_width)
        cloud = extract_boundary(holes, workspace, chosen)
        assert share_found(cloud, holes, workspace, 8 * PIXEL) == 0.0
        assert len(cloud) > 50  # the other three edges


@pytest.mark.parametrize("nothing", [0.0, np.nan, -1.0, np.inf])
def test_a_frame_without_depth_has_no_points(nothing: float) -> None:
    frame, workspace = seen(PLATE)
    cloud = extract_boundary(replace(frame, depth=np.full_like(frame.depth, nothing)), workspace)
    assert len(cloud) == 0
    assert cloud.points_cam.shape == (0, 3)
    assert cloud.pixels.shape == (0, 2)


def test_a_grey_image_without_edges_has_no_points() -> None:
    frame, workspace = seen(PLATE)
    plain = np.full_like(frame.grey, 90)
    plain[:, :4] = 91
    assert len(extract_boundary(replace(frame, grey=plain), workspace)) == 0


def test_a_bin_out_of_view_has_no_points() -> None:
    frame, workspace = seen(PLATE)
    beside = replace(workspace, T_world_bin=make_transform(translation=(5.0, 0.0, 0.0)) @ workspace.T_world_bin)
    behind = replace(workspace, T_world_bin=make_transform(translation=(0.0, 0.0, 2.0)) @ workspace.T_world_bin)
    assert len(extract_boundary(frame, beside)) == 0
    assert len(extract_boundary(frame, behind)) == 0


# --- container -------------------------------------------------------------------------------------------------------


def walls() -> list[Plate]:
    """Return the bin's four inner walls, each of its own grey."""
    half, height = INNER[:2] / 2, INNER[2]
    upright_x, upright_y = rotation_about((0, 1, 0), np.pi / 2), rotation_about((1, 0, 0), np.pi / 2)
    return [
        *(
            Plate(T_bin_plate=make_transform(upright_x, (s * half[0], 0, height / 2)), size=(height, INNER[1]), grey=g)
            for s, g in ((-1, 110), (1, 150))
        ),
        *(
            Plate(T_bin_plate=make_transform(upright_y, (0, s * half[1], height / 2)), size=(INNER[0], height), grey=g)
            for s, g in ((-1, 100), (1, 130))
        ),
    ]


@pytest.mark.parametrize("view", VIEWS)
def test_the_containers_own_edges_are_removed(view: str) -> None:
    yaw, turn = VIEWS[view]
    stripe = flat(0.03, 0.05, 0.0005, (0.2, 0.02), 250)  # paint on the floor
    beside = flat(0.0, 0.17, 0.05, (0.3, 0.02), 250)  # outside; inside, if the bin's x and y were swapped
    frame, workspace = seen(stripe, beside, *walls(), yaw=yaw, turn=turn)
    anywhere = replace(workspace, inner_size=np.array([1.0, 1.0, 1.0]))
    assert len(extract_boundary(frame, anywhere)) > 500
    removed = extract_boundary(frame, workspace)
    assert len(removed) == 0
    assert removed.outside > 100
    frame, _ = seen(stripe, beside, *walls(), PLATE, yaw=yaw, turn=turn)
    points_plate = on_plate(frame, workspace, extract_boundary(frame, workspace).points_cam)
    assert np.abs(points_plate[:, 2]).max() < 1e-6
    assert missed(points_plate).max() < 2.0 * PIXEL


@pytest.mark.parametrize(("height", "kept"), [(0.002, False), (0.004, True), (0.145, True), (0.155, False)])
def test_margin_and_headroom_bound_what_lies_in_the_bin(height: float, kept: bool) -> None:
    frame, workspace = seen(flat(0.05, 0.02, height, (0.06, 0.04)), yaw=0.4, turn=TILTED)
    assert (len(extract_boundary(frame, workspace)) > 0) == kept
    roomy = BoundarySettings(margin=0.001, headroom=0.05)
    assert len(extract_boundary(frame, workspace, roomy)) > 0


@pytest.mark.parametrize(("std", "kept"), [(0.0005, False), (0.003, True)])
def test_parts_on_a_floor_whose_height_is_uncertain_are_kept(std: float, kept: bool) -> None:
    """The plate lies 2 mm above it, and the margin of 3 mm covers an uncertainty of 1 mm."""
    frame, workspace = seen(flat(0.05, 0.02, 0.002, (0.06, 0.04)), yaw=0.4, turn=TILTED)
    assert (len(extract_boundary(frame, replace(workspace, translation_std=std))) > 0) == kept
    tilted = replace(workspace, rotation_std=std / (INNER[0] / 2))  # as much at the ends of the bin
    assert (len(extract_boundary(frame, tilted)) > 0) == kept


def test_a_bin_keeps_the_same_points_whichever_side_is_called_its_length() -> None:
    frame, workspace = seen(flat(0.05, 0.02, 0.002, (0.06, 0.04)), yaw=0.4, turn=TILTED)
    uncertain = replace(workspace, rotation_std=0.0022 / (INNER[0] / 2))
    turned = replace(
        uncertain,
        T_world_bin=uncertain.T_world_bin @ make_transform(rotation_about((0, 0, 1), np.pi / 2)),
        inner_size=uncertain.inner_size[[1, 0, 2]],
    )
    points = extract_boundary(frame, uncertain).points_cam
    assert len(points) > 0
    np.testing.assert_array_equal(extract_boundary(frame, turned).points_cam, points)


@pytest.mark.parametrize(("std", "kept"), [(0.0005, False), (0.003, True)])
def test_parts_at_a_wall_whose_place_is_uncertain_are_kept(std: float, kept: bool) -> None:
    """The long side of the plate lies 2 mm from a wall."""
    beside = flat(0.05, INNER[1] / 2 - 0.002 - 0.005, 0.02, (0.06, 0.01))
    frame, workspace = seen(beside, yaw=0.4, turn=TILTED)
    points = extract_boundary(frame, replace(workspace, translation_std=std)).points_cam
    points_plate = on_plate(frame, workspace, points, beside)
    assert (np.abs(points_plate[:, 1] - 0.005).min() < 0.001) == kept


# --- every point, once and in order ----------------------------------------------------------------------------------


def clutter(seed: int) -> tuple[Frame, Workspace]:
    """Return ten plates at random heights with noise and holes in depth."""
    rng = np.random.default_rng(seed)
    plates = [
        flat(*rng.uniform((-0.14, -0.1), (0.14, 0.1)), 0.01 * (k + 1), (0.06, 0.04), int(rng.integers(80, 255)))
        for k in range(10)
    ]
    frame, workspace = seen(*plates, yaw=rng.uniform(0, 6), turn=TILTED)
    depth = frame.depth + rng.normal(0, 0.0005, frame.depth.shape)
    depth[rng.random(depth.shape) < 0.3] = np.nan
    return replace(frame, depth=depth), workspace


@pytest.mark.parametrize("seed", range(3))
def test_points_are_unique_in_reading_order_and_on_their_pixels(seed: int) -> None:
    frame, workspace = clutter(seed)
    cloud = extract_boundary(frame, workspace)
    assert len(cloud) > 300
    assert (np.diff(cloud.pixels[:, 1] * SIZE[0] + cloud.pixels[:, 0]) > 0).all()
    np.testing.assert_array_equal(cloud.points_cam[:, 2], frame.depth[cloud.pixels[:, 1], cloud.pixels[:, 0]])
    np.testing.assert_allclose(project_points(K, cloud.points_cam), cloud.pixels, atol=1e-9)
    lengths = np.linalg.norm(cloud.tangents_cam, axis=1)
    assert np.all(np.isclose(lengths, 1.0) | (lengths == 0.0))
    assert cloud.linearity.min() >= 0.0
    assert cloud.linearity.max() <= 1.0


@pytest.mark.slow
def test_the_same_frame_gives_the_same_bits_and_is_left_alone() -> None:
    frame, workspace = clutter(7)
    grey, depth = frame.grey.copy(), frame.depth.copy()
    first = extract_boundary(frame, workspace)
    np.testing.assert_array_equal(frame.grey, grey)
    np.testing.assert_array_equal(frame.depth, depth)
    strided = replace(frame, grey=np.repeat(grey, 2, axis=1)[:, ::2], depth=np.asfortranarray(depth))
    for again in (extract_boundary(frame, workspace), extract_boundary(strided, workspace)):
        for name in ("points_cam", "tangents_cam", "linearity", "pixels"):
            np.testing.assert_array_equal(getattr(again, name), getattr(first, name), err_msg=name)


def test_every_setting_counts() -> None:
    frame, workspace = clutter(3)
    first = extract_boundary(frame, workspace)
    changes: list[dict[str, Any]] = [
        {"low": 400.0, "high": 400.0}, {"blur": 0.0}, {"radius": 0, "widest": 0}, {"radius": 8, "widest": 8},
        {"step": 0.02}, {"widest": 2, "radius": 0}, {"window": 3}, {"margin": 0.03}, {"headroom": 0.0, "margin": 0.02},
    ]  # fmt: skip
    for change in changes:
        other = extract_boundary(frame, workspace, BoundarySettings(**change))
        same = len(other) == len(first) and np.array_equal(other.tangents_cam, first.tangents_cam)
        assert not same, change


def test_a_weak_edge_counts_where_it_goes_on_from_a_strong_one() -> None:
    frame, workspace = seen(PLATE)
    across = np.arange(SIZE[0]) - np.nonzero(frame.grey == PLATE.grey)[1].min()
    grey = np.where(frame.grey == PLATE.grey, 60 + across.clip(0), 60).astype(np.uint8)  # fading to the left
    faded = replace(frame, grey=grey)
    found = [len(extract_boundary(faded, workspace, BoundarySettings(low=low))) for low in (39.0, 15.0, 5.0)]
    assert found[0] + 5 < found[1] < found[2] - 5
    assert len(extract_boundary(faded, workspace, BoundarySettings(high=400.0))) == 0


def test_organised_points_by_hand() -> None:
    frame, _ = seen(PLATE)
    depth = np.zeros_like(frame.depth)
    depth[100, 250] = 0.5
    (point,) = organised_points(replace(frame, depth=depth), np.array([(250, 100)]))
    np.testing.assert_allclose(point, [0.5 * (250 - K[0, 2]) / 520, 0.5 * (100 - K[1, 2]) / 535, 0.5])


# --- nonsense --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"low": 50.0}, r"low must be between 0 and high, got 50\.0 and 40\.0"),
        ({"low": -1.0}, r"low must be between 0 and high, got -1\.0 and 40\.0"),
        ({"high": np.nan}, r"low must be between 0 and high, got 15\.0 and nan"),
        ({"radius": 7}, "radius must be between 0 and widest, got 7 and 6"),
        ({"radius": -1}, "radius must be between 0 and widest, got -1 and 6"),
        ({"window": 0}, "window must be at least 1 px, got 0"),
        ({"blur": -1.0}, r"blur must not be negative, got -1\.0"),
        ({"step": np.nan}, "step must not be negative, got nan"),
        ({"margin": -0.1}, r"margin must not be negative, got -0\.1"),
        ({"headroom": -np.inf}, "headroom must not be negative, got -inf"),
    ],
)
def test_nonsense_in_the_settings_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        BoundarySettings(**changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"points_cam": np.zeros((2, 4))}, r"points_cam must be \(N, 3\), got \(2, 4\)"),
        ({"tangents_cam": np.zeros((3, 3))}, r"tangents_cam must be \(2, 3\), got \(3, 3\)"),
        ({"linearity": np.zeros((2, 1))}, r"linearity must be \(2,\), got \(2, 1\)"),
        ({"pixels": np.zeros((1, 2), np.int64)}, r"pixels must be \(2, 2\), got \(1, 2\)"),
        ({"points_cam": np.array([[0.0, 0, 1], [0, np.nan, 1]])}, r"must be finite, point 1 is \[0\.0, nan, 1\.0\]"),
    ],
)
def test_nonsense_in_a_cloud_is_refused(changes: dict[str, Any], text: str) -> None:
    whole = {
        "points_cam": np.ones((2, 3)),
        "tangents_cam": np.zeros((2, 3)),
        "linearity": np.zeros(2),
        "pixels": np.zeros((2, 2), np.int64),
    }
    assert len(BoundaryCloud(**whole)) == 2
    with pytest.raises(ValueError, match=text):
        BoundaryCloud(**whole | changes)

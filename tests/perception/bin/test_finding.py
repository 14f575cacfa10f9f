from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from perception.bin import BinFit, find_bin
from perception.frame import Frame, Workspace
from perception.geometry import Floats, camera_matrix, invert_transform, make_transform, rotation_about, rotation_angle
from tests.perception.bin import box_scene as scene

OFF = make_transform(rotation_about((1.0, 2.0, 0.5), np.deg2rad(2.0)), (0.006, -0.006, 0.005))  # about the camera
FAR_OFF = make_transform(rotation_about((1.0, -2.0, 0.5), np.deg2rad(6.0)), (0.016, -0.026, 0.015))
AT = scene.view()
PILE = [scene.TABLE, *scene.walls(), *scene.blocks(30)]
EMPTY = [scene.TABLE, *scene.walls()]


def errors(fit: BinFit, frame: Frame, at: scene.View = AT) -> tuple[float, float]:
    """Return the error of the bin's pose in the camera's frame: distance [mm] and angle [deg]."""
    assert fit.T_world_bin is not None
    true = invert_transform(at.T_world_cam) @ at.T_world_bin
    T = invert_transform(true) @ invert_transform(frame.T_world_cam) @ fit.T_world_bin
    return 1000 * float(np.linalg.norm(T[:3, 3])), float(np.degrees(rotation_angle(T[:3, :3])))


@pytest.mark.parametrize("boxes", [EMPTY, PILE], ids=["empty", "full"])
@pytest.mark.parametrize("off", [np.eye(4), OFF, FAR_OFF], ids=["right", "off", "far_off"])
def test_a_bin_is_found_though_its_pose_is_wrong(boxes: list[scene.Box], off: Floats) -> None:
    frame = AT.off(AT.see(boxes), off)
    fit = find_bin(frame, scene.INNER, scene.workspace(AT))
    away, turned = errors(fit, frame)
    assert fit.reliable
    assert away < 0.5
    assert turned < 0.1
    assert set(fit.seen) == {"floor", "rim", "wall_x+", "wall_x-", "wall_y+", "wall_y-"}
    assert fit.residual < 0.001
    np.testing.assert_allclose(fit.opening, scene.INNER[:2], atol=0.001)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("near", [True, False])
def test_a_bin_is_found_by_its_edges_where_depth_noise_is_large(near: bool, seed: int) -> None:
    """Points of parts beside a wall are not taken for its inner face."""
    at = scene.view(noise=0.002)
    frame = at.see(PILE, seed)
    fit = find_bin(frame, scene.INNER, scene.workspace(at) if near else None)
    away, turned = errors(fit, frame, at)
    assert fit.reliable
    assert away < 1000 * fit.translation_std
    assert turned < 0.1


def test_the_offset_is_that_of_the_believed_pose() -> None:
    frame = AT.off(AT.see(PILE), OFF)
    fit = find_bin(frame, scene.INNER, scene.workspace(AT))
    T = AT.T_world_cam @ OFF @ invert_transform(AT.T_world_cam)  # moves what the camera sees in the world
    moved = invert_transform(AT.T_world_bin) @ T @ AT.T_world_bin
    distance, angle = fit.offset_from(scene.workspace(AT))
    assert distance == pytest.approx(float(np.linalg.norm(moved[:3, 3])), abs=0.0005)
    assert angle == pytest.approx(np.deg2rad(2.0), abs=0.002)


@pytest.mark.parametrize("boxes", [EMPTY, PILE], ids=["empty", "full"])
@pytest.mark.parametrize("near", [True, False])
def test_an_unknown_size_is_measured(boxes: list[scene.Box], near: bool) -> None:
    frame = AT.see(boxes)
    fit = find_bin(frame, None, scene.workspace(AT) if near else None)
    assert fit.inner_size is not None
    np.testing.assert_allclose(fit.inner_size, scene.INNER, atol=0.001)
    T = fit.T_world_bin
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], AT.T_world_bin[:3, 3], atol=0.0006)
    assert fit.opening[0] > fit.opening[1]


def test_a_bin_whose_length_points_down_in_the_image_is_recognised_by_its_size() -> None:
    at = scene.view(yaw=np.pi / 2, distance=1.1)
    frame = at.see(EMPTY)
    fit = find_bin(frame, scene.INNER)
    away, turned = errors(fit, frame, at)
    assert away < 0.6
    assert turned < 0.2 or turned > 179.8  # half a turn cannot be seen


def test_noise_and_a_pile_on_the_rim_are_endured() -> None:
    at = scene.view(noise=0.001, steepest=np.deg2rad(65))
    over = [((0.05, -0.16, 0.11), (0.11, -0.06, 0.14)), ((-0.2, 0.0, 0.125), (-0.1, 0.05, 0.15))]
    frame = at.off(at.see([*PILE, *over]), OFF)
    fit = find_bin(frame, scene.INNER, scene.workspace(at))
    away, turned = errors(fit, frame, at)
    assert away < 1.0
    assert turned < 0.2


def test_flat_parts_all_over_the_floor_are_no_floor() -> None:
    cover = ((-0.18, -0.13, 0.0), (0.18, 0.13, 0.006))
    frame = AT.see([*EMPTY, cover])
    fit = find_bin(frame, scene.INNER, scene.workspace(AT))
    assert errors(fit, frame)[0] < 0.6
    assert "floor" not in fit.seen
    assert 0.0008 < fit.translation_std < 0.003  # the stated height of the rim is not exact


@pytest.mark.parametrize("missing", [0.002, 0.004, 0.008])
@pytest.mark.parametrize("near", [True, False])
def test_a_floor_that_is_lower_than_the_stated_height_counts(missing: float, near: bool) -> None:
    stated = scene.INNER - np.array([0.0, 0.0, missing])
    frame = AT.off(AT.see(EMPTY), OFF)
    fit = find_bin(frame, stated, scene.workspace(AT, stated) if near else None)
    assert fit.reliable
    assert "floor" in fit.seen
    away, turned = errors(fit, frame)
    assert away < 0.5
    assert turned < 0.1 or turned > 179.9  # half a turn cannot be seen


def test_a_bin_that_reaches_out_of_the_image_is_found_by_the_edges_in_view() -> None:
    frame = AT.off(AT.see(PILE), OFF)
    depth = frame.depth.copy()
    depth[:, 480:] = 0.0
    fit = find_bin(replace(frame, depth=depth), scene.INNER, scene.workspace(AT))
    away, turned = errors(fit, frame)
    assert "wall_x+" not in fit.seen
    assert np.isnan(fit.opening[0])
    assert away < 1.0
    assert turned < 0.2


def test_a_bin_whose_rim_is_out_of_the_image_is_not_measured() -> None:
    at = scene.view(distance=0.5)
    fit = find_bin(at.see(PILE), scene.INNER, scene.workspace(at))
    assert fit.reason == "its rim was not found"


def test_a_table_has_a_floor_only() -> None:
    frame = AT.see([scene.FLOOR, *scene.blocks(5)])
    fit = find_bin(frame, None)
    assert fit.reliable
    assert fit.seen == ("floor",)
    assert not fit.walls_seen
    assert fit.inner_size is None
    assert fit.T_world_bin is not None
    np.testing.assert_allclose(fit.T_world_bin[:3, 2], AT.T_world_bin[:3, 2], atol=0.002)
    height = invert_transform(AT.T_world_bin) @ fit.T_world_bin[:, 3]
    assert height[2] == pytest.approx(0.0, abs=0.0005)
    with pytest.raises(ValueError, match="the fit has no inner_size: no walls were seen; state inner_size"):
        fit.workspace()


def test_without_walls_only_height_and_tilt_are_corrected() -> None:
    frame = AT.off(AT.see([scene.FLOOR, *scene.blocks(5)]), OFF)
    near = scene.workspace(AT)
    fit = find_bin(frame, scene.INNER, near)
    assert fit.reliable
    assert fit.seen == ("floor",)
    true = frame.T_world_cam @ invert_transform(AT.T_world_cam) @ AT.T_world_bin  # where the camera sees the floor
    assert fit.T_world_bin is not None
    T = invert_transform(true) @ fit.T_world_bin
    assert T[2, 3] == pytest.approx(0.0, abs=0.001)
    np.testing.assert_allclose(T[:3, 2], [0, 0, 1], atol=0.003)
    assert np.linalg.norm(fit.T_world_bin[:3, 3] - near.T_world_bin[:3, 3]) > 0.005


@pytest.mark.parametrize(
    ("boxes", "size", "reason"),
    [
        ([], scene.INNER, "hardly any pixel has a depth"),
        ([((-2.0, -2.0, -0.6), (2.0, 2.0, -0.5))], scene.INNER, "its rim was not found"),
        (EMPTY, np.array([0.38, 0.28, 0.12]), r"its opening measures 359 x 260 mm, but inner_size says 380 x 280 mm"),
    ],
)
def test_where_too_little_is_seen_the_fit_says_why_and_keeps_the_pose(
    boxes: list[scene.Box], size: Floats, reason: str
) -> None:
    near = Workspace(T_world_bin=AT.T_world_bin, inner_size=size)
    fit = find_bin(AT.see(boxes), size, near)
    assert not fit.reliable
    assert fit.reason is not None
    assert fit.reason == reason
    assert fit.T_world_bin is near.T_world_bin
    assert fit.seen == ()
    np.testing.assert_array_equal(fit.workspace().inner_size, size)


def test_a_bin_that_is_far_away_is_not_taken() -> None:
    aside = Workspace(T_world_bin=AT.T_world_bin @ make_transform(translation=(0.3, 0, 0)), inner_size=scene.INNER)
    fit = find_bin(AT.see(PILE), scene.INNER, aside)
    assert fit.reason is not None
    assert fit.T_world_bin is aside.T_world_bin


def test_a_bin_whose_middle_lies_behind_the_camera_is_not_measured() -> None:
    inner = np.array([1.0, 0.3, 0.12])
    along = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]  # a camera that looks along the bin, turned down by 26 degrees
    down = rotation_about((1, 0, 0), np.deg2rad(-26))
    T_bin_cam = make_transform(np.array(along) @ down, (0.2, 0.0, 0.35))
    at = replace(AT, T_world_cam=AT.T_world_bin @ T_bin_cam, K=camera_matrix(400.0, 640, 480))
    fit = find_bin(at.see([scene.TABLE, *scene.walls(inner)]), inner, scene.workspace(at, inner))
    assert invert_transform(T_bin_cam)[2, 3] < 0
    assert fit.reason == "its rim was not found"


def test_nothing_is_known_without_depth_and_without_a_pose() -> None:
    fit = find_bin(AT.see([]), None)
    assert (fit.T_world_bin, fit.inner_size) == (None, None)
    with pytest.raises(ValueError, match="the fit has no pose: hardly any pixel has a depth"):
        fit.workspace()
    with pytest.raises(ValueError, match="the fit has no pose: hardly any pixel has a depth"):
        fit.offset_from(scene.workspace(AT))


def test_the_same_frame_gives_the_same_bits() -> None:
    frame = AT.see(PILE)
    one, other = (find_bin(frame, scene.INNER, scene.workspace(AT)) for _ in range(2))
    np.testing.assert_array_equal(one.T_world_bin, other.T_world_bin)


def test_another_image_size_finds_the_same_bin() -> None:
    at = scene.view(size=(320, 240), K=camera_matrix(425.0, 320, 240))
    frame = at.off(at.see(PILE), OFF)
    away, turned = errors(find_bin(frame, scene.INNER, scene.workspace(at)), frame, at)
    assert away < 1.0
    assert turned < 0.2


@pytest.mark.parametrize("size", [np.array([0.3, 0.2]), np.array([0.3, -0.2, 0.1]), np.array([0.3, 0.2, np.inf])])
def test_a_size_that_is_none_is_refused(size: Floats) -> None:
    with pytest.raises(ValueError, match="inner_size must be"):
        find_bin(AT.see(EMPTY), size)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"T_world_bin": None}, "a reliable fit must have a pose, got None"),
        ({"opening": np.zeros(3)}, r"opening must be \(2,\), got \(3,\)"),
        ({"points": {"lid": 3}}, r"points must be of floor, rim, wall_x\+.*, got lid"),
    ],
)
def test_a_fit_without_sense_is_refused(changes: dict[str, Any], text: str) -> None:
    fit = find_bin(AT.see(EMPTY), scene.INNER, scene.workspace(AT))
    with pytest.raises(ValueError, match=text):
        replace(fit, **changes)


@pytest.mark.parametrize(
    ("stated", "text"), [(2 * scene.INNER, "720 x 520"), (np.array([0.4, 0.3, 0.12]), "400 x 300")]
)
def test_an_opening_of_another_size_is_named(stated: Floats, text: str) -> None:
    fit = find_bin(AT.see(PILE), stated)
    np.testing.assert_allclose(fit.opening, [0.36, 0.26], atol=0.004)
    assert fit.reason is not None
    assert fit.reason.startswith("its rim was not found; an opening of about 3")
    assert fit.reason.endswith(f" mm is seen, but inner_size says {text} mm")
    assert not fit.reliable

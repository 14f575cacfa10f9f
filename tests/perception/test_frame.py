"""What a camera delivers is cleaned and checked at the door; what is in the bin is decided by hand-worked boxes."""

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.capture.images import metres
from perception.frame import Frame, Workspace
from perception.geometry import camera_matrix, invert_transform, make_transform, random_rotation, rotation_about

SHAPE = (4, 6)
INNER = np.array([0.36, 0.26, 0.12])


def frame(**changes: Any) -> Frame:
    facts: dict[str, Any] = {
        "grey": np.zeros(SHAPE, np.uint8),
        "depth": np.full(SHAPE, 0.9, np.float32),
        "K": camera_matrix(100.0, 6, 4),
        "T_world_cam": np.eye(4),
    }
    return Frame(**(facts | changes))


def workspace(yaw: float = 0.0, position: tuple[float, float, float] = (0.5, 0.1, 0.02)) -> Workspace:
    return Workspace(T_world_bin=make_transform(rotation_about((0, 0, 1), yaw), position), inner_size=INNER)


# --- Frame -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -0.9, 0.0, -0.0, -1e-30, 1e6, 1e38, 1e300])
def test_what_is_no_distance_becomes_zero(bad: float) -> None:
    depth = np.full(SHAPE, 0.9)
    depth[1, 2] = bad
    given_depth = depth.copy()
    seen = frame(depth=depth)
    assert seen.depth[1, 2] == 0.0
    assert not seen.valid[1, 2]
    assert seen.valid.sum() == 23
    assert np.all(seen.depth[seen.valid] == np.float32(0.9))
    assert seen.depth.dtype == np.float32
    assert seen.valid.shape == SHAPE
    np.testing.assert_array_equal(depth, given_depth)  # the caller's array is his own


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_the_farthest_distance_is_that_of_the_readers(dtype: type) -> None:
    depth = np.array([[0.5, 999_999.0, 65504.0], [1_000_000.0, np.inf, 1e37]])
    with np.errstate(over="ignore"):
        stored = depth.astype(dtype)
    K = camera_matrix(100.0, 3, 2)
    seen = Frame(depth=stored, K=K, T_world_cam=np.eye(4))
    np.testing.assert_array_equal(seen.depth, metres(stored, None, ()))


def test_masked_depths_are_no_measurements() -> None:
    masked: np.ma.MaskedArray = np.ma.masked_greater(np.array([[0.5, 0.6, 4.0]]), 1.0)
    seen = Frame(depth=masked, K=camera_matrix(5.0, 3, 1), T_world_cam=np.eye(4))
    np.testing.assert_array_equal(seen.valid, [[True, True, False]])


def test_depths_that_are_all_too_far_are_said(caplog: pytest.LogCaptureFixture) -> None:
    frame(depth=np.full(SHAPE, 1e38, np.float32))
    assert "all depths are 1e+06 m or more and count as missing: is their unit the metre?" in caplog.text
    caplog.clear()
    frame(depth=np.array([[1e38, 0.9, np.nan, np.inf, 0, -1]] * 4))
    frame(depth=np.full(SHAPE, np.inf))
    assert caplog.text == ""


def test_a_frame_keeps_no_hold_of_the_callers_depth() -> None:
    depth = np.full(SHAPE, 0.9, np.float32)
    seen = frame(depth=depth)
    depth[:] = np.nan
    assert seen.valid.all()


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(width=32), min_size=24, max_size=24), st.sampled_from([np.float16, np.float32, np.float64]))
def test_any_depth_is_finite_and_not_negative_afterwards(values: list[float], dtype: type) -> None:
    with np.errstate(over="ignore"):
        depth: np.ndarray = np.array(values).reshape(SHAPE).astype(dtype)
    seen = frame(depth=depth)
    assert np.all(np.isfinite(seen.depth))
    assert np.all(seen.depth >= 0)
    np.testing.assert_array_equal(seen.valid, seen.depth > 0)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"depth": np.ones((4, 5))}, "grey and depth must have the same shape (H, W), got (4, 6) and (4, 5)"),
        ({"depth": np.ones((4, 6, 1))}, "grey and depth must have the same shape (H, W), got (4, 6) and (4, 6, 1)"),
        (
            {"grey": np.zeros((4, 6, 3), np.uint8), "depth": np.ones((4, 6, 3))},
            "grey and depth must have the same shape (H, W), got (4, 6, 3) and (4, 6, 3)",
        ),
        (
            {"grey": np.zeros(SHAPE, np.float32)},
            "grey must be uint8, levels from 0 to 255, got float32: use astype(np.uint8)",
        ),
        (
            {"depth": np.full(SHAPE, 900, np.uint16)},
            "depth must be floating point metres, got uint16 (millimetres in integers?)",
        ),
        ({"K": np.eye(4)}, "K must be (3, 3), got (4, 4)"),
        ({"T_world_cam": np.eye(3)}, "T_world_cam must be (4, 4), got (3, 3)"),
        (
            {"K": np.diag([0.0, 100.0, 1.0])},
            "K must be finite with positive focal lengths, got [[0.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 1.0]]",
        ),
        (
            {"K": np.diag([100.0, -100.0, 1.0])},
            "K must be finite with positive focal lengths, got "
            "[[100.0, 0.0, 0.0], [0.0, -100.0, 0.0], [0.0, 0.0, 1.0]]",
        ),
        (
            {"K": np.diag([100.0, 0.0, 1.0])},
            "K must be finite with positive focal lengths, got [[100.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]",
        ),
        (
            {"K": np.diag([100.0, 100.0, np.nan])},
            "K must be finite with positive focal lengths, got [[100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, nan]]",
        ),
        (
            {"K": camera_matrix(100.0, 6, 4).T},
            "K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got "
            "[[100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [2.5, 1.5, 1.0]]: is it transposed?",
        ),
        (
            {"K": np.array([[100.0, 120.0, 2.5], [0.0, 100.0, 1.5], [0.0, 0.0, 1.0]])},
            "K must have no skew, got K[0, 1] = 120 px: calibrate without skew, or rectify the images",
        ),
        ({"K": "K"}, "K must be an array of numbers, got 'K'"),
        ({"K": [[1.0, 2.0], [3.0]]}, "K must be an array of numbers, got [[1.0, 2.0], [3.0]]"),
        ({"depth": None}, "grey and depth must have the same shape (H, W), got (4, 6) and ()"),
        (
            {"K": camera_matrix(0.1, 6, 4)},
            "K does not fit the image: with fx = 0.1 px, a width of 6 px is a field of view of 176 degrees, "
            "which must be between 0.5 and 170; focal lengths are in pixels of this image",
        ),
        (
            {"K": camera_matrix(600.0, 6, 4)},
            "K does not fit the image: with fy = 600 px, a height of 4 px is a field of view of 0.382 degrees, "
            "which must be between 0.5 and 170; focal lengths are in pixels of this image",
        ),
        (
            {"K": camera_matrix(100.0, 1206, 4)},
            "K does not fit the image: its principal point (602.5, 1.5) px lies so far outside the image of 6 x 4 px "
            "that a side of it would be 80.6 degrees off the optical axis, which must be at most 80; K must be that of "
            "this resolution and crop",
        ),
        ({"T_world_cam": np.diag([1.0, 1.0, 1.0, np.nan])}, "T_world_cam must be finite"),
        (
            {"T_world_cam": np.diag([1.0, 1.0, -1.0, 1.0])},
            "T_world_cam must be right-handed, but its rotation has the determinant -1: it mirrors. Turn an axis into "
            "the cross product of the other two, or ask for the right-handed axes of the source",
        ),
        (
            {"T_world_cam": np.diag([1.0, 1.002, 1.0, 1.0])},
            "T_world_cam must be rigid, a rotation and a translation, but R^T R differs from the identity by 0.004: "
            "remove its scale and shear",
        ),
        (
            {"T_world_cam": make_transform(translation=(0.1, 0.2, 0.9)).T},
            "the last row of T_world_cam must be [0, 0, 0, 1], got [0.1, 0.2, 0.9, 1.0] (is it transposed?)",
        ),
        (
            {"T_world_cam": np.diag([1.0, 1.0, 1.0, 0.001])},
            "the last row of T_world_cam must be [0, 0, 0, 1], got [0.0, 0.0, 0.0, 0.001]",
        ),
    ],
)
def test_a_frame_that_makes_no_sense_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        frame(**changes)


def test_lists_and_tuples_of_numbers_are_taken() -> None:
    plain = frame()
    lists = frame(
        grey=np.zeros(SHAPE, np.uint8),
        depth=plain.depth.tolist(),
        K=[[100, 0, 2.5], [0, 100, 1.5], [0, 0, 1]],
        T_world_cam=tuple(map(tuple, plain.T_world_cam.tolist())),
    )
    np.testing.assert_array_equal(lists.depth, plain.depth)
    assert lists.depth.dtype == np.float32
    np.testing.assert_array_equal(lists.T_world_cam, plain.T_world_cam)
    assert lists.K.dtype == lists.T_world_cam.dtype == np.float64
    whole = Workspace(T_world_bin=np.eye(4, dtype=int).tolist(), inner_size=(1, 2, 3))  # type: ignore[arg-type]
    np.testing.assert_array_equal(whole.inner_size, [1.0, 2.0, 3.0])


# --- Workspace -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"T_world_bin": np.eye(3)}, "T_world_bin must be (4, 4), got (3, 3)"),
        (
            {"T_world_bin": np.diag([-1.0, 1.0, 1.0, 1.0])},
            "T_world_bin must be right-handed, but its rotation has the determinant -1: it mirrors. Turn an axis into "
            "the cross product of the other two, or ask for the right-handed axes of the source",
        ),
        ({"inner_size": np.ones(2)}, "inner_size must be (3,), got (2,)"),
        ({"inner_size": None}, "inner_size must be (3,), got ()"),
        ({"T_world_bin": "eye"}, "T_world_bin must be an array of numbers, got 'eye'"),
        ({"inner_size": np.array([0.3, 0.0, 0.1])}, "inner_size must be positive and finite, got [0.3, 0.0, 0.1]"),
        ({"translation_std": -0.001}, "translation_std must be 0 or more and finite, got -0.001"),
        ({"rotation_std": np.inf}, "rotation_std must be 0 or more and finite, got inf"),
        ({"inner_size": np.array([0.3, np.inf, 0.1])}, "inner_size must be positive and finite, got [0.3, inf, 0.1]"),
        ({"inner_size": np.array([0.3, np.nan, 0.1])}, "inner_size must be positive and finite, got [0.3, nan, 0.1]"),
    ],
)
def test_a_bin_that_makes_no_sense_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        Workspace(**({"T_world_bin": np.eye(4), "inner_size": INNER} | changes))


def test_the_bin_frame_by_hand() -> None:
    # A quarter turn to the left: the bin's x is the world's y, its y the world's -x.
    cell = workspace(np.pi / 2)
    points_world = np.array([[0.5, 0.1, 0.02], [0.5, 0.25, 0.02], [0.4, 0.1, 0.02], [0.5, 0.1, 0.12]])
    expected = np.array([[0, 0, 0], [0.15, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    np.testing.assert_allclose(cell.to_bin(points_world), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("point", "inside", "inside_turned"),
    [
        ((0.5, 0.1, 0.05), True, True),
        ((0.67, 0.1, 0.05), True, False),  # 17 cm along the world's x: along the bin's length, or across it
        ((0.5, 0.27, 0.05), False, True),
        ((0.69, 0.1, 0.05), False, False),
        ((0.31, 0.1, 0.05), False, False),
        ((0.5, 0.1, 0.015), False, False),  # in the floor
        ((0.5, 0.1, 0.145), False, False),  # above the rim
        ((0.5, 0.1, 0.135), True, True),
    ],
)
def test_a_point_in_the_bin(point: tuple[float, float, float], inside: bool, inside_turned: bool) -> None:
    assert workspace().contains(np.array([point])).tolist() == [inside]
    assert workspace(np.pi / 2).contains(np.array([point])).tolist() == [inside_turned]
    assert workspace(-np.pi).contains(np.array([point])).tolist() == [inside]


def test_a_bin_turned_by_30_degrees_has_its_corner_where_it_must() -> None:
    cell = workspace(np.pi / 6, position=(0.0, 0.0, 0.0))
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    for length, across, inside in [(0.179, 0.129, True), (0.181, 0.129, False), (0.179, 0.131, False)]:
        corner = (c * length - s * across, s * length + c * across, 0.01)
        mirrored = (c * length + s * across, s * length - c * across, 0.01)
        assert cell.contains(np.array([corner, mirrored])).tolist() == [inside, inside]
    assert not cell.contains(np.array([[0.179, 0.129, 0.01]]))[0]  # which is inside if the yaw is ignored or reversed


def test_margin_shrinks_walls_and_floor_and_headroom_raises_the_top() -> None:
    cell = Workspace(T_world_bin=np.eye(4), inner_size=INNER)
    near_wall, on_floor, over_rim = np.array([[0.175, 0.0, 0.05], [0.0, 0.0, 0.005], [0.0, 0.0, 0.15]])
    points = np.stack([near_wall, on_floor, over_rim])
    assert cell.contains(points).tolist() == [True, True, False]
    assert cell.contains(points, margin=0.01).tolist() == [False, False, False]
    assert cell.contains(points, headroom=0.04).tolist() == [True, True, True]
    assert cell.contains(points, margin=0.01, headroom=0.04).tolist() == [False, False, True]
    assert cell.contains(np.array([[0.0, 0.0, 0.119]]), margin=0.01).tolist() == [True]  # not the top


def test_the_walls_belong_to_the_bin_and_no_point_to_none() -> None:
    cell = Workspace(T_world_bin=np.eye(4), inner_size=INNER)
    assert cell.contains(np.array([[0.18, 0.13, 0.0], [-0.18, -0.13, 0.12]])).all()
    assert cell.contains(np.zeros((0, 3))).shape == (0,)
    assert not cell.contains(np.full((1, 3), np.nan))[0]


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_the_bin_takes_its_points_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_world_bin = make_transform(random_rotation(rng), rng.normal(size=3))
    points_bin = rng.uniform(-0.2, 0.2, size=(50, 3))
    points_world = points_bin @ T_world_bin[:3, :3].T + T_world_bin[:3, 3]
    cell = Workspace(T_world_bin=T_world_bin, inner_size=INNER)
    np.testing.assert_allclose(cell.to_bin(points_world), points_bin, atol=1e-12)
    by_hand = [abs(x) <= 0.18 and abs(y) <= 0.13 and 0 <= z <= 0.12 for x, y, z in points_bin]
    assert cell.contains(points_world).tolist() == by_hand
    np.testing.assert_allclose(invert_transform(T_world_bin) @ T_world_bin, np.eye(4), atol=1e-12)


def test_a_rounded_pose_and_a_crop_are_accepted() -> None:
    R = rotation_about((1.0, 0.3, 0.0), 2.7)
    frame(T_world_cam=make_transform(R.round(3), (0.0, 0.0, 0.9)))
    frame(K=camera_matrix(100.0, 6, 4) + np.array([[0, 0, 9.0], [0, 0, -5.0], [0, 0, 0]]))  # beside the image
    frame(K=camera_matrix(100.0, 6, 4) + np.array([[0, 0, 400.0], [0, 0, -300.0], [0, 0, 0]]))  # far beside it
    Workspace(T_world_bin=make_transform(R.round(3)), inner_size=INNER)


def test_a_frame_has_a_depth_wherever_it_is() -> None:
    depth = np.zeros((40, 40), np.float32)
    K = camera_matrix(100.0, 40, 40)
    facts: dict[str, Any] = {"K": K, "T_world_cam": np.eye(4)}
    assert not Frame(depth=depth, **facts).has_depth
    for row, column in ((16, 32), (17, 3)):  # one of the pixels that are asked first, and one between them
        one = depth.copy()
        one[row, column] = 0.9
        assert Frame(depth=one, **facts).has_depth

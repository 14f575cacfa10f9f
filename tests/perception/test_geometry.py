"""Rigid transforms, quaternions and the pinhole camera: by hand, by their laws, against scipy."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from perception.geometry import (
    Floats,
    camera_matrix,
    deproject_depth,
    invert_transform,
    make_transform,
    matrix_from_quat,
    pixel_rays,
    project_points,
    quat_from_matrix,
    random_rotation,
    require_shape,
    rotation_6d,
    rotation_about,
    rotation_angle,
    rotation_from_6d,
    sampling_step,
    transform_point_each,
    transform_points,
)

X, Y, Z = np.eye(3)
QUARTER_Z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
K = camera_matrix(600.0, 9, 7)

seeds = st.integers(0, 2**32 - 1)
batches = st.sampled_from([(), (1,), (3,), (2, 3), (0,)])
# From none over barely any to all but half a turn.
tiny = st.sampled_from([0.0, 1e-15, 1e-12, 1e-8, 1e-5, 1e-3])
angles = st.one_of(tiny, tiny.map(lambda x: np.pi - x), st.floats(0.0, np.pi))
vectors = st.tuples(*[st.floats(-10.0, 10.0)] * 3).map(np.array)
axes = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3)


def uniform(rng: np.random.Generator, batch: tuple[int, ...]) -> Floats:
    return Rotation.random(int(np.prod(batch)), rng=rng).as_matrix().reshape(*batch, 3, 3)


def near_identity(rng: np.random.Generator, batch: tuple[int, ...]) -> Floats:
    turns = rng.normal(size=(int(np.prod(batch)), 3)) * 10.0 ** rng.uniform(-14, -2)
    return Rotation.from_rotvec(turns).as_matrix().reshape(*batch, 3, 3)


def half_turns(rng: np.random.Generator, batch: tuple[int, ...]) -> Floats:
    axis = rng.normal(size=(int(np.prod(batch)), 3))
    return Rotation.from_rotvec(np.pi * axis / np.linalg.norm(axis, axis=1)[:, None]).as_matrix().reshape(*batch, 3, 3)


draws = st.sampled_from([uniform, near_identity, half_turns])
Draw = Callable[[np.random.Generator, tuple[int, ...]], Floats]


def transforms(draw: Draw, rng: np.random.Generator, batch: tuple[int, ...]) -> Floats:
    T = np.zeros((*batch, 4, 4))
    T[..., :3, :3] = draw(rng, batch)
    T[..., :3, 3] = rng.normal(size=(*batch, 3))
    T[..., 3, 3] = 1.0
    return T


# --- transforms ------------------------------------------------------------------------------------------------------


def test_a_transform_maps_b_to_a() -> None:
    T_a_b = make_transform(QUARTER_Z, (10.0, 20.0, 30.0))  # b stands at (10, 20, 30), its x along a's y
    mapped = transform_points(T_a_b, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 3.0]]))
    np.testing.assert_allclose(mapped, [[10, 20, 30], [10, 21, 30], [8, 20, 33]])
    np.testing.assert_allclose(T_a_b @ [0.0, 2.0, 3.0, 1.0], [8, 20, 33, 1])


def test_either_half_of_a_transform_may_be_left_out() -> None:
    np.testing.assert_array_equal(make_transform(), np.eye(4))
    np.testing.assert_array_equal(make_transform(QUARTER_Z)[:3, 3], 0.0)
    np.testing.assert_array_equal(make_transform(translation=(1, 2, 3))[:3, :3], np.eye(3))
    assert make_transform(translation=(1, 2, 3)).dtype == np.float64


def test_an_inverse_by_hand() -> None:
    T_b_a = invert_transform(make_transform(QUARTER_Z, (1.0, 2.0, 3.0)))
    np.testing.assert_array_equal(T_b_a, [[0, 1, 0, -2], [-1, 0, 0, 1], [0, 0, 1, -3], [0, 0, 0, 1]])


@settings(deadline=None)
@given(draws, seeds, batches)
def test_the_inverse_undoes(draw: Draw, seed: int, batch: tuple[int, ...]) -> None:
    T = transforms(draw, np.random.default_rng(seed), batch)
    before = T.copy()
    inverse = invert_transform(T)
    assert inverse.shape == T.shape
    np.testing.assert_allclose(inverse @ T, np.broadcast_to(np.eye(4), T.shape), atol=1e-13)
    np.testing.assert_allclose(inverse, np.linalg.inv(T), atol=1e-13)
    np.testing.assert_array_equal(T, before)


@settings(deadline=None)
@given(draws, seeds, st.integers(0, 5))
def test_points_go_there_and_back_and_through_a_product(draw: Draw, seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    T_a_b, T_b_c = transforms(draw, rng, (2,))
    points_c = rng.normal(size=(count, 3))
    points_a = transform_points(T_a_b @ T_b_c, points_c)
    assert points_a.shape == (count, 3)
    np.testing.assert_allclose(points_a, transform_points(T_a_b, transform_points(T_b_c, points_c)), atol=1e-13)
    np.testing.assert_allclose(transform_points(invert_transform(T_a_b @ T_b_c), points_a), points_c, atol=1e-12)
    homogeneous = np.column_stack([points_c, np.ones(count)]) @ (T_a_b @ T_b_c).T
    np.testing.assert_allclose(points_a, homogeneous[:, :3], atol=1e-13)


# --- quaternions -----------------------------------------------------------------------------------------------------


def test_quaternions_are_wxyz() -> None:
    half = np.sqrt(0.5)
    np.testing.assert_allclose(quat_from_matrix(np.eye(3)), [1, 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(quat_from_matrix(QUARTER_Z), [half, 0, 0, half], atol=1e-15)
    np.testing.assert_allclose(matrix_from_quat([half, 0, 0, half]), QUARTER_Z, atol=1e-15)
    np.testing.assert_allclose(matrix_from_quat([0, 1, 0, 0]), np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_quaternions_are_mujocos() -> None:
    mujoco = pytest.importorskip("mujoco")
    quat = Rotation.random(rng=np.random.default_rng(0)).as_quat(canonical=True, scalar_first=True)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat)
    np.testing.assert_allclose(matrix_from_quat(quat), matrix.reshape(3, 3), atol=1e-14)
    np.testing.assert_allclose(quat_from_matrix(matrix.reshape(3, 3)), quat, atol=1e-14)


@settings(deadline=None)
@given(draws, seeds, batches.filter(lambda batch: len(batch) < 2))
def test_quaternions_agree_with_scipy_and_go_back(draw: Draw, seed: int, batch: tuple[int, ...]) -> None:
    R = draw(np.random.default_rng(seed), batch)
    quat = quat_from_matrix(R)
    assert quat.shape == (*batch, 4)
    assert np.all(quat[..., 0] >= 0)
    np.testing.assert_allclose(np.linalg.norm(quat, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(quat[..., [1, 2, 3, 0]], Rotation.from_matrix(R).as_quat(canonical=True), atol=1e-14)
    back = matrix_from_quat(quat)
    assert back.shape == R.shape
    np.testing.assert_allclose(back, R, atol=1e-13)
    np.testing.assert_allclose(matrix_from_quat(-quat), R, atol=1e-13)  # both signs are one rotation
    np.testing.assert_allclose(matrix_from_quat(3.0 * quat), R, atol=1e-13)


@settings(deadline=None)
@given(seeds, st.sampled_from([(2, 3), (0, 2)]))
def test_quaternions_take_any_number_of_leading_axes(seed: int, batch: tuple[int, ...]) -> None:
    R = uniform(np.random.default_rng(seed), batch)
    assert quat_from_matrix(R).shape == (*batch, 4)
    np.testing.assert_allclose(matrix_from_quat(quat_from_matrix(R)), R, atol=1e-13)


# --- axis and angle --------------------------------------------------------------------------------------------------


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    np.testing.assert_allclose(rotation_about(Z, np.pi / 2), QUARTER_Z, atol=1e-15)
    np.testing.assert_allclose(rotation_about((0, 0, 7), np.pi / 2) @ X, Y, atol=1e-15)
    np.testing.assert_allclose(rotation_about(X, np.pi / 2) @ Y, Z, atol=1e-15)
    np.testing.assert_allclose(rotation_about(Y, np.pi / 2) @ Z, X, atol=1e-15)


@settings(deadline=None)
@given(axes, angles)
def test_the_angle_is_found_again_at_its_full_precision(axis: Floats, angle: float) -> None:
    R = rotation_about(axis, angle)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ axis, axis, atol=1e-13)
    assert float(rotation_angle(R)) == pytest.approx(angle, rel=1e-9, abs=2e-15)
    assert float(rotation_angle(rotation_about(axis, -angle))) == pytest.approx(angle, rel=1e-9, abs=2e-15)
    np.testing.assert_allclose(R, Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle).as_matrix(), atol=1e-14)


def test_the_angle_of_no_turn_and_of_half_a_turn() -> None:
    assert float(rotation_angle(np.eye(3))) == 0.0
    assert float(rotation_angle(np.diag([1.0, -1.0, -1.0]))) == pytest.approx(np.pi, abs=1e-15)
    assert float(rotation_angle(rotation_about(X, 1e-9))) == pytest.approx(1e-9, rel=1e-6)  # acos would say 0
    assert float(rotation_angle(rotation_about(X, 1.5 * np.pi))) == pytest.approx(np.pi / 2)


@settings(deadline=None)
@given(draws, seeds, batches)
def test_angles_take_batches_and_agree_with_scipy(draw: Draw, seed: int, batch: tuple[int, ...]) -> None:
    R = draw(np.random.default_rng(seed), batch)
    angle = np.asarray(rotation_angle(R))
    assert angle.shape == batch
    one_by_one = [Rotation.from_matrix(r).magnitude() for r in R.reshape(-1, 3, 3)]
    np.testing.assert_allclose(angle.ravel(), one_by_one, atol=1e-7)


# --- 6-D encoding ----------------------------------------------------------------------------------------------------


def test_the_encoding_is_the_first_two_columns() -> None:
    np.testing.assert_array_equal(rotation_6d(np.arange(9.0).reshape(3, 3)), [0, 3, 6, 1, 4, 7])
    np.testing.assert_array_equal(rotation_6d(QUARTER_Z), [0, 1, 0, -1, 0, 0])


@settings(deadline=None)
@given(draws, seeds, batches)
def test_the_encoding_goes_back(draw: Draw, seed: int, batch: tuple[int, ...]) -> None:
    R = draw(np.random.default_rng(seed), batch)
    encoding = rotation_6d(R)
    assert encoding.shape == (*batch, 6)
    np.testing.assert_allclose(rotation_from_6d(encoding), R, atol=1e-13)


@settings(deadline=None)
@given(seeds, batches)
def test_any_six_numbers_give_a_rotation(seed: int, batch: tuple[int, ...]) -> None:
    encoding = np.random.default_rng(seed).normal(size=(*batch, 6))
    R = rotation_from_6d(encoding)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-7)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-7)
    along = np.sum(R[..., :, 0] * encoding[..., :3], axis=-1)
    np.testing.assert_allclose(along, np.linalg.norm(encoding[..., :3], axis=-1), rtol=1e-12)
    assert np.all(np.sum(R[..., :, 1] * encoding[..., 3:], axis=-1) > 0)
    scaled = encoding * np.array([2.0] * 3 + [5.0] * 3)
    np.testing.assert_allclose(rotation_from_6d(scaled), R, atol=1e-7)


# --- random rotations ------------------------------------------------------------------------------------------------


def test_random_rotations_are_uniform_and_seeded() -> None:
    rng = np.random.default_rng(0)
    R = np.stack([random_rotation(rng) for _ in range(4000)])
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    assert np.abs(R.mean(axis=0)).max() < 0.04  # of entries with variance 1/3: 4 sigma
    np.testing.assert_allclose((R**2).mean(axis=0), 1 / 3, atol=0.02)
    # The angle of uniform rotations has the density (1 - cos) / pi, hence the mean pi/2 + 2/pi.
    assert float(np.mean(rotation_angle(R))) == pytest.approx(np.pi / 2 + 2 / np.pi, abs=0.04)
    np.testing.assert_array_equal(random_rotation(np.random.default_rng(0)), R[0])


# --- camera ----------------------------------------------------------------------------------------------------------


def test_the_principal_point_is_the_middle_of_the_image() -> None:
    np.testing.assert_array_equal(K, [[600, 0, 4], [0, 600, 3], [0, 0, 1]])
    np.testing.assert_array_equal(camera_matrix(2.0, 4, 2)[:2, 2], [1.5, 0.5])  # pixel centres at integers


def test_a_known_point_falls_on_its_pixel_and_comes_back() -> None:
    depth = np.zeros((7, 9), np.float32)
    depth[1, 6] = 1.2
    cloud_cam = deproject_depth(K, depth)
    assert cloud_cam.shape == (7, 9, 3)
    assert cloud_cam.dtype == np.float64
    np.testing.assert_allclose(cloud_cam[1, 6], [2 * 1.2 / 600, -2 * 1.2 / 600, 1.2], rtol=1e-6)
    np.testing.assert_allclose(project_points(K, cloud_cam[1, 6][None]), [[6, 1]], rtol=1e-6)


def test_x_is_right_y_is_down_and_z_is_forward() -> None:
    ahead, right, below, farther = project_points(K, np.array([[0, 0, 1], [0.01, 0, 1], [0, 0.01, 1], [0.01, 0, 2.0]]))
    np.testing.assert_allclose(ahead, [4, 3])
    np.testing.assert_allclose(right - ahead, [6, 0])
    np.testing.assert_allclose(below - ahead, [0, 6])
    np.testing.assert_allclose(farther - ahead, [3, 0])
    cloud_cam = deproject_depth(K, np.ones((7, 9)))
    assert cloud_cam[3, 8, 0] > 0 > cloud_cam[3, 0, 0]
    assert cloud_cam[6, 4, 1] > 0 > cloud_cam[0, 4, 1]


def test_a_ray_has_depth_1_and_is_shown_by_its_pixel() -> None:
    pixels = np.array([[6, 1], [4, 3], [0, 6]])
    rays = pixel_rays(K, pixels)
    np.testing.assert_array_equal(rays[:, 2], 1.0)
    np.testing.assert_allclose(rays[0], [2 / 600, -2 / 600, 1.0])
    np.testing.assert_allclose(project_points(K, rays), pixels, atol=1e-12)


@pytest.mark.parametrize(("pixels", "step"), [(0, 1), (50_000, 1), (50_001, 2), (200_000, 2), (1280 * 960, 5)])
def test_every_step_th_row_and_column_of_an_image_are_at_most_about_so_many(pixels: int, step: int) -> None:
    assert sampling_step(pixels, 50_000) == step


@settings(deadline=None)
@given(st.integers(1, 12), st.integers(1, 9), st.floats(50.0, 3000.0), seeds)
def test_every_pixel_is_found_again(width: int, height: int, focal: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = camera_matrix(focal, width, height)
    matrix[0, 0] *= rng.uniform(0.8, 1.2)  # pixels need not be square, nor the centre in the middle
    matrix[:2, 2] += rng.uniform(-3, 3, size=2)
    depth = rng.uniform(0.1, 3.0, size=(height, width))
    cloud_cam = deproject_depth(matrix, depth)
    np.testing.assert_array_equal(cloud_cam[..., 2], depth)
    v, u = np.mgrid[:height, :width]
    pixels = project_points(matrix, cloud_cam.reshape(-1, 3))
    np.testing.assert_allclose(pixels, np.stack([u.ravel(), v.ravel()], axis=1), atol=1e-9)


def test_invalid_depth_gives_the_origin_or_nan() -> None:
    cloud_cam = deproject_depth(K, np.where(np.eye(7, 9) > 0, np.nan, 0.0))
    assert np.isnan(cloud_cam[2, 2]).all()
    np.testing.assert_array_equal(cloud_cam[2, 3], 0.0)


# --- require_shape ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("have", "want", "text"),
    [
        ((512, 4), (None, 3), "points_cam must be (N, 3), got (512, 4)"),
        ((3,), (None, 3), "points_cam must be (N, 3), got (3,)"),
        ((4,), (3,), "points_cam must be (3,), got (4,)"),
        ((), (3,), "points_cam must be (3,), got ()"),
        ((1, 4, 4), (4, 4), "points_cam must be (4, 4), got (1, 4, 4)"),
        ((2, 2), (None,), "points_cam must be (N,), got (2, 2)"),
    ],
)
def test_a_wrong_shape_is_told(have: tuple[int, ...], want: tuple[int | None, ...], text: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(text)}$"):
        require_shape("points_cam", np.zeros(have), want)


@pytest.mark.parametrize(("have", "want"), [((512, 3), (None, 3)), ((0, 3), (None, 3)), ((3,), (3,)), ((), ())])
def test_a_right_shape_passes(have: tuple[int, ...], want: tuple[int | None, ...]) -> None:
    require_shape("points_cam", np.zeros(have), want)


def test_one_point_by_many_transforms() -> None:
    rng = np.random.default_rng(0)
    poses = np.stack([make_transform(random_rotation(rng), rng.normal(size=3)) for _ in range(5)])
    point = rng.normal(size=3)
    expected = [transform_points(pose, point[None])[0] for pose in poses]
    np.testing.assert_allclose(transform_point_each(poses, point), expected)
    assert transform_point_each(np.zeros((0, 4, 4)), point).shape == (0, 3)

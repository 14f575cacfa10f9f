"""K is recovered from organised clouds, other clouds are projected, and no pinhole is invented where there is none."""

from typing import Any

import numpy as np
import pytest

from perception.capture import Calibration
from perception.capture.cloud import Cloud
from perception.capture.cloud_frame import CloudImages, images_of_cloud
from perception.capture.pinhole import fit_pinhole, require_pinhole, residual_of
from perception.capture.projection import project_cloud
from perception.geometry import make_transform, rotation_about, transform_points
from tests.perception.capture.camera_files import HEIGHT, WIDTH, K, scene_depth, scene_points

V = make_transform(rotation_about((1, 0.2, 0.1), 2.5), (0.3, -0.2, 1.1))


def images(cloud: Cloud, calibration: Calibration | None = None, **changes: Any) -> CloudImages:
    return images_of_cloud(cloud, calibration, **({"scale": 1.0, "axes": "opencv", "project": False} | changes))


def test_k_is_recovered_from_a_cloud() -> None:
    fit = fit_pinhole(scene_points(np.float32).astype(np.float64))
    np.testing.assert_allclose(fit.K, K, rtol=1e-5)
    assert fit.residual < 1e-5
    require_pinhole(fit)


def test_points_that_no_camera_has_are_missing() -> None:
    points = scene_points().astype(np.float64)
    clean, dirty = points.copy(), points.copy()
    clean[2, 3], dirty[2, 3] = np.nan, np.finfo(np.float32).max
    for changes in ({}, {"project": True, "calibration": Calibration(K=K, size=(WIDTH, HEIGHT))}):
        wanted, got = (images(Cloud(points=each), **changes) for each in (clean, dirty))
        np.testing.assert_array_equal(got.depth, wanted.depth)
        np.testing.assert_array_equal(got.K, wanted.K)
        assert got.unseen == wanted.unseen


def test_a_cloud_that_is_all_too_far_is_said(caplog: pytest.LogCaptureFixture) -> None:
    points = scene_points().astype(np.float64)
    stated = Calibration(K=K, size=(WIDTH, HEIGHT))
    images(Cloud(points=points), stated, project=True)
    assert caplog.text == ""
    assert not images(Cloud(points=points), stated, project=True, scale=1e9).depth.any()
    assert "all points of the cloud lie 1e+06 m or more away and count as missing: is scale right" in caplog.text


def test_the_residual_is_the_noise_of_the_projections() -> None:
    rng = np.random.default_rng(0)
    u, v = np.meshgrid(np.arange(60.0), np.arange(50.0))
    directions = np.stack([(u - 30) / 80, (v - 25) / 80, np.ones((50, 60))], axis=-1)
    noise = rng.normal(0, 0.2 / 80, (50, 60, 2))
    directions[..., :2] += noise
    fit = fit_pinhole(directions)
    assert fit.residual == pytest.approx(0.2 * np.sqrt(2), rel=0.05)
    assert residual_of(fit.K, directions) == pytest.approx(fit.residual, rel=0.02)


def test_clouds_that_no_pinhole_explains_are_refused_with_the_residual() -> None:
    u, v = np.meshgrid(np.arange(60.0), np.arange(50.0))
    bumpy = 0.8 + 0.3 * ((u + v) % 2)
    orthographic = np.stack([0.01 * u - 0.3, 0.01 * v - 0.25, bumpy], axis=-1)
    with pytest.raises(ValueError, match=r"explained by a pinhole camera to 0\.5 px .* got a residual of \d\.\d\d px"):
        images(Cloud(points=orthographic))


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (np.full((4, 5, 3), np.nan), "must hold measured points, got none"),
        (np.zeros((4, 5, 3)), "must hold measured points, got none"),
        (scene_points() * (1, -1, -1), r'z > 0\), got 0 of 46 points there: if z points backwards, set axes="opengl"'),
        (np.tile([0.1, 0.2, 0.9], (4, 5, 1)), "must cover several rows and columns to recover K: state K"),
    ],
)
def test_clouds_without_a_camera_matrix_are_refused(points: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        images(Cloud(points=points))


def test_a_cloud_with_y_upwards_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"must have x to the right and y down, got the focal lengths 20\.0 and -21\.0"
    ):
        images(Cloud(points=scene_points() * (1, -1, 1)))


def test_opengl_axes_are_turned() -> None:
    seen = images(Cloud(points=scene_points() * (1, -1, -1)), axes="opengl")
    np.testing.assert_array_equal(seen.depth, scene_depth())
    np.testing.assert_allclose(seen.K, K, rtol=1e-9)


def test_the_scale_is_the_length_of_a_unit() -> None:
    seen = images(Cloud(points=scene_points() * 1000), scale=0.001)
    np.testing.assert_allclose(seen.depth, scene_depth(), rtol=1e-6)


@pytest.mark.parametrize("in_sensor_frame", [False, True])
def test_the_viewpoint_is_applied_in_the_reading_that_a_pinhole_explains(in_sensor_frame: bool) -> None:
    points = scene_points()
    if not in_sensor_frame:
        points = transform_points(V, points.reshape(-1, 3)).reshape(points.shape)
    seen = images(Cloud(points=points, viewpoint=V))
    np.testing.assert_allclose(seen.depth, scene_depth(), atol=1e-6)
    np.testing.assert_allclose(seen.K, K, rtol=1e-6)
    assert seen.T_world_cam is not None
    np.testing.assert_allclose(seen.T_world_cam, V)


def test_the_viewpoint_of_a_scattered_cloud_in_millimetres_and_opengl_axes_is_applied() -> None:
    flip = np.diag([1.0, -1, -1, 1])
    points = scene_points().reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    pose = V.copy()
    pose[:3, 3] *= 1000
    cloud = Cloud(points=1000 * transform_points(V @ flip, points)[None], viewpoint=pose)
    calibration = Calibration(K=K, size=(WIDTH, HEIGHT))
    seen = images(cloud, calibration, scale=0.001, axes="opengl")
    np.testing.assert_allclose(seen.depth, scene_depth(), atol=1e-6)
    assert seen.T_world_cam is not None
    np.testing.assert_allclose(seen.T_world_cam, V @ flip)


def test_a_stated_camera_must_explain_an_organised_cloud() -> None:
    seen = images(Cloud(points=scene_points()), Calibration(K=K))
    assert seen.residual is not None
    assert seen.residual < 1e-9
    wrong = Calibration(K=K * [[1.5], [1.5], [1]])
    with pytest.raises(ValueError, match=r"must explain the organised cloud to 1.0 px \(root mean square\), got \d"):
        images(Cloud(points=scene_points()), wrong)
    with pytest.raises(ValueError, match="got inf px"):
        images(Cloud(points=-scene_points()), Calibration(K=K))


def test_scattered_clouds_need_a_camera_with_a_size() -> None:
    cloud = Cloud(points=scene_points().reshape(1, -1, 3))
    for calibration in (None, Calibration(K=K)):
        with pytest.raises(ValueError, match=r"an unorganised cloud \(48 points in one row\) .* needs a calibration"):
            images(cloud, calibration)
    assert images(cloud, Calibration(K=K, size=(WIDTH, HEIGHT))).residual is None


def test_the_nearest_point_of_a_pixel_is_seen_and_a_hole_has_its_neighbours_grey() -> None:
    points = np.array([[0, 0, 0.9], [0, 0, 0.7], [0, 0, 0.8], [0, 0, -0.5], [9, 0, 0.5], [0.1, 0, 1.0]])
    camera = np.array([[20.0, 0, 2], [0, 20, 1], [0, 0, 1]])
    depth, grey = project_cloud(points, camera, (5, 3), np.arange(10, 16, dtype=np.uint8))
    wanted = np.zeros((3, 5), np.float32)
    wanted[1, 2], wanted[1, 4] = 0.7, 1.0
    np.testing.assert_array_equal(depth, wanted)
    assert grey is not None
    assert grey[:, 0].tolist() == [11, 11, 11]
    assert grey[:, 4].tolist() == [15, 15, 15]
    unseen = images(Cloud(points=points[None]), Calibration(K=camera, size=(5, 3))).unseen
    assert unseen == 4
    empty, image = project_cloud(points[:0], camera, (5, 3), np.zeros(0, np.uint8))
    assert not empty.any()
    assert image is not None
    assert not image.any()


def test_clouds_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"points must be \(H, W, 3\), got \(4, 3\)"):
        Cloud(points=np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"grey must be \(4, 5\) as the points are, got \(5, 4\)"):
        Cloud(points=np.zeros((4, 5, 3)), grey=np.zeros((5, 4), np.uint8))

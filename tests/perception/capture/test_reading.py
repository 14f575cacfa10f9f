"""Frames come out of files as the camera took them, whatever the format; files that do not fit together are refused."""

import json
import logging
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.capture import Calibration, ReadOptions, read_frame, read_frame_with_report, write_frame
from perception.capture.content import Content
from perception.capture.reading import _from_cloud
from perception.frame import Frame
from perception.geometry import make_transform
from tests.perception.capture.camera_files import HEIGHT, WIDTH, K, pcd_header, scene_depth, scene_points, written

GREY = np.arange(WIDTH * HEIGHT, dtype=np.uint8).reshape(HEIGHT, WIDTH)
POSE = make_transform(np.diag([1.0, -1, -1]), (0.1, 0.2, 0.9))


@pytest.fixture
def depth_file(tmp_path: Path) -> Path:
    path = tmp_path / "000017.png"
    cv2.imwrite(str(path), np.rint(scene_depth() * 1000).astype(np.uint16))
    cv2.imwrite(str(tmp_path / "grey.png"), GREY)
    return path


def millimetres() -> Any:
    return np.rint(scene_depth() * 1000).astype(np.float64) / 1000


@pytest.mark.parametrize("calibration", [K, K.tolist(), K.astype(np.float32), Calibration(K=K)])
def test_a_depth_image_with_a_grey_image(depth_file: Path, calibration: Any) -> None:
    frame, report = read_frame_with_report(
        depth_file, grey=depth_file.with_name("grey.png"), calibration=calibration, T_world_cam=POSE.tolist()
    )
    np.testing.assert_array_equal(frame.grey, GREY)
    np.testing.assert_array_equal(frame.depth, millimetres().astype(np.float32))
    np.testing.assert_allclose(frame.K, K, rtol=1e-7)
    np.testing.assert_array_equal(frame.T_world_cam, POSE)
    assert (report.source, report.grey, report.undistorted) == ("depth image", "image", False)
    assert report.measured_fraction == pytest.approx(46 / 48)


def test_bops_image_is_found_by_the_name_of_the_file(depth_file: Path) -> None:
    pose = {"cam_R_w2c": np.eye(3).ravel().tolist(), "cam_t_w2c": [0, 0, 500]}
    entry = {"cam_K": K.ravel().tolist(), "depth_scale": 0.5, **pose}
    cameras = written(depth_file.with_name("scene_camera.json"), json.dumps({"3": {}, "17": entry}))
    frame, report = read_frame_with_report(depth_file, calibration=cameras)
    np.testing.assert_allclose(frame.depth, scene_depth() / 2, atol=3e-4)
    assert frame.T_world_cam[2, 3] == -0.5
    assert report.grey == "none"
    assert not frame.grey.any()
    stated = read_frame(depth_file, calibration=cameras, options=ReadOptions(scale=0.001))
    np.testing.assert_allclose(stated.depth, scene_depth(), atol=6e-4)


def test_distortion_is_removed_and_said(depth_file: Path) -> None:
    calibration = Calibration(K=K, distortion=np.array([-3.0, 0, 0, 0]))
    grey = depth_file.with_name("grey.png")
    frame, report = read_frame_with_report(depth_file, grey=grey, calibration=calibration)
    assert report.undistorted
    assert set(np.unique(frame.depth)) <= {0, *np.unique(millimetres().astype(np.float32))}
    assert (frame.grey != GREY).any()


def test_a_scaled_image_is_read_when_stated(depth_file: Path) -> None:
    large = Calibration(K=K, size=(WIDTH, HEIGHT)).scaled((2 * WIDTH, 2 * HEIGHT))
    with pytest.raises(ValueError, match="must have the calibrated size 16 x 12, got 8 x 6"):
        read_frame(depth_file, calibration=large)
    frame = read_frame(depth_file, calibration=large, options=ReadOptions(fit="scale"))
    np.testing.assert_allclose(frame.K, K)


def test_crops_come_before_turns(depth_file: Path) -> None:
    options = ReadOptions(crop=(2, 1, 4, 3), quarter_turns=1)
    frame = read_frame(depth_file, grey=depth_file.with_name("grey.png"), calibration=K, options=options)
    np.testing.assert_array_equal(frame.grey, np.rot90(GREY[1:4, 2:6]))


def test_missing_values_and_floating_point(tmp_path: Path) -> None:
    raw = np.full((HEIGHT, WIDTH), 900, np.uint16)
    raw[0, :3] = 0, 65535, 4000
    np.save(tmp_path / "a.npy", raw)
    assert np.count_nonzero(read_frame(tmp_path / "a.npy", calibration=K).valid) == WIDTH * HEIGHT - 2
    options = ReadOptions(missing=(4000,))
    assert read_frame(tmp_path / "a.npy", calibration=K, options=options).depth[0, 1] == np.float32(65.535)
    np.save(tmp_path / "b.npy", scene_depth())
    calibration = Calibration(K=K, depth_scale=0.001)  # of integers
    np.testing.assert_array_equal(read_frame(tmp_path / "b.npy", calibration=calibration).depth, scene_depth())


def test_distances_along_the_rays_become_depths(tmp_path: Path) -> None:
    v, u = np.indices((HEIGHT, WIDTH))
    rays = np.stack([u, v, np.ones_like(u)], axis=2) @ np.linalg.inv(K).T
    np.save(tmp_path / "a.npy", (scene_depth() * np.linalg.norm(rays, axis=2)).astype(np.float32))
    frame = read_frame(tmp_path / "a.npy", calibration=K, options=ReadOptions(depth_along="ray"))
    np.testing.assert_allclose(frame.depth, scene_depth(), rtol=1e-6)
    assert not np.allclose(read_frame(tmp_path / "a.npy", calibration=K).depth, scene_depth(), rtol=1e-3)


def test_a_unit_that_is_probably_wrong_is_warned_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    np.save(tmp_path / "a.npy", scene_depth() * 1000)
    with caplog.at_level(logging.INFO):
        read_frame(tmp_path / "a.npy", calibration=K)
    assert "the median depth is 8" in caplog.text
    assert "is scale right (0.001 for millimetres)" in caplog.text
    assert "source='depth image'" in caplog.text


def test_an_organised_cloud_needs_nothing_else(tmp_path: Path) -> None:
    table = np.zeros(WIDTH * HEIGHT, [("p", "<f4", 3), ("rgb", "<u4")])
    table["p"], table["rgb"] = scene_points().reshape(-1, 3), 0x646464
    path = written(tmp_path / "a.pcd", pcd_header("x y z rgb", "4 4 4 4", "F F F U", "binary") + table.tobytes())
    frame, report = read_frame_with_report(path)
    np.testing.assert_array_equal(frame.depth, scene_depth())
    np.testing.assert_allclose(frame.K, K, rtol=1e-5)
    assert (report.source, report.grey, report.K_recovered) == ("organised cloud", "cloud", True)
    assert report.K_residual is not None
    assert report.K_residual < 1e-4
    assert (frame.grey == 100).all()
    cv2.imwrite(str(tmp_path / "grey.png"), GREY)
    np.testing.assert_array_equal(read_frame(path, grey=tmp_path / "grey.png").grey, GREY)


@pytest.mark.parametrize("name", ["a.npz", "a.json"])
def test_a_frame_without_a_grey_image_is_kept_as_one(tmp_path: Path, name: str) -> None:
    write_frame(Frame(depth=scene_depth(), K=K, T_world_cam=POSE), tmp_path / name)
    frame, report = read_frame_with_report(tmp_path / name)
    assert report.grey == "none"
    assert not frame.has_grey


@pytest.mark.parametrize("kind", ["npy", "tiff", "npz"])
def test_clouds_in_arrays_and_images(tmp_path: Path, kind: str) -> None:
    path, points = tmp_path / f"a.{kind}", scene_points(np.float32)
    if kind == "npy":
        np.save(path, points)
    elif kind == "tiff":
        cv2.imwrite(str(path), np.ascontiguousarray(points[:, :, ::-1]))  # x is stored first
    else:
        np.savez(path, xyz=points, color=np.dstack([GREY, GREY, GREY]))
    frame, report = read_frame_with_report(path)
    np.testing.assert_array_equal(frame.depth, scene_depth())
    assert report.grey == ("image" if kind == "npz" else "none")
    assert kind != "npz" or (frame.grey == GREY).all()


def test_a_depth_image_in_every_channel_is_no_cloud(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.dstack([scene_depth()] * 3))
    frame, report = read_frame_with_report(tmp_path / "a.npy", calibration=K)
    np.testing.assert_array_equal(frame.depth, scene_depth())
    assert report.source == "depth image"


def test_a_colour_image_in_an_npz_is_red_first(tmp_path: Path) -> None:
    colour = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    colour[:, :, 0] = 255
    np.savez(tmp_path / "a.npz", depth=scene_depth(), rgb=colour, K=K)
    assert (read_frame(tmp_path / "a.npz").grey == 76).all()


def test_a_scattered_cloud_is_projected_and_said(tmp_path: Path) -> None:
    points = scene_points().reshape(-1, 3)
    points = np.vstack([points[np.isfinite(points).all(axis=1)], [[0, 0, 5.0]]])
    np.savez(tmp_path / "a.npz", points=points)
    calibration = Calibration(K=K, size=(WIDTH, HEIGHT))
    frame, report = read_frame_with_report(tmp_path / "a.npz", calibration=calibration)
    np.testing.assert_allclose(frame.depth, scene_depth(), rtol=1e-6)
    assert (report.source, report.K_residual, report.unseen_points) == ("projected cloud", None, 1)


def test_a_grid_that_the_file_does_not_state(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=scene_points().reshape(-1, 3))
    frame, report = read_frame_with_report(tmp_path / "a.npz", options=ReadOptions(grid=(WIDTH, HEIGHT)))
    np.testing.assert_array_equal(frame.depth, scene_depth())
    assert report.source == "organised cloud"
    with pytest.raises(ValueError, match="grid must have a cell for each of the 48 points, got 7 x 7"):
        read_frame(tmp_path / "a.npz", options=ReadOptions(grid=(7, 7)))


def test_an_npy_file_of_n_by_3_points_is_a_cloud(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, scene_points().reshape(-1, 3))
    with pytest.raises(ValueError, match=r"unorganised cloud \(48 points in one row\) (.|\n)* ReadOptions\(grid="):
        read_frame(path, calibration=K)
    organised, report = read_frame_with_report(path, options=ReadOptions(grid=(WIDTH, HEIGHT)))
    assert report.source == "organised cloud"
    projected, report = read_frame_with_report(path, calibration=Calibration(K=K, size=(WIDTH, HEIGHT)))
    assert report.source == "projected cloud"
    np.testing.assert_allclose(projected.depth, organised.depth, rtol=1e-6)


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((48, 3), np.int64), ((48, 3), np.uint16), ((48, 4), np.float64), ((48, 6), np.float32), ((48, 1, 3), np.int32)],
)
def test_an_npy_file_of_another_table_of_points_is_refused_as_one(
    tmp_path: Path, shape: tuple[int, ...], dtype: type
) -> None:
    np.save(tmp_path / "a.npy", np.full(shape, 900, dtype))
    text = rf"a\.npy must be a depth image .* got {np.dtype(dtype)} of shape .* looks like a table of points: save x, y"
    with pytest.raises(ValueError, match=text):
        read_frame(tmp_path / "a.npy", calibration=K)


def test_the_grey_image_of_a_projected_cloud_is_undistorted(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", scene_points())
    cv2.imwrite(str(tmp_path / "grey.png"), GREY)
    calibration = Calibration(K=K, size=(WIDTH, HEIGHT), distortion=np.array([-3.0, 0, 0, 0]))
    frame, report = read_frame_with_report(
        tmp_path / "a.npy",
        grey=tmp_path / "grey.png",
        calibration=calibration,
        options=ReadOptions(project=True),
    )
    np.testing.assert_allclose(frame.depth, scene_depth(), rtol=1e-6)
    assert report.undistorted
    assert (frame.grey != GREY).any()


def test_files_that_do_not_fit_together_are_refused(depth_file: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"the depth image 000017\.png needs a calibration: pass calibration="):
        read_frame(depth_file)
    cv2.imwrite(str(tmp_path / "small.png"), GREY[:3])
    text = r"must be registered to the depth and have its size \(H, W\) = \(6, 8\), got \(3, 8\)"
    with pytest.raises(ValueError, match=text):
        read_frame(depth_file, grey=tmp_path / "small.png", calibration=K)
    with pytest.raises(ValueError, match="T_world_cam must be right-handed"):
        read_frame(depth_file, calibration=K, T_world_cam=np.diag([1, 1, -1, 1]))
    with pytest.raises(FileNotFoundError):
        read_frame(tmp_path / "none.png", calibration=K)
    np.savez(tmp_path / "a.npz", stuff=GREY)
    with pytest.raises(ValueError, match=r"must hold 'depth' \(H, W\), or points .* got \['stuff'\]"):
        read_frame(tmp_path / "a.npz")
    written(tmp_path / "camera.json", "{}")
    with pytest.raises(ValueError, match="if it is a calibration, read the depth image and pass this file"):
        read_frame(tmp_path / "camera.json")
    with pytest.raises(ValueError, match="a cloud is required"):
        _from_cloud(Content(), None, ReadOptions())


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"scale": "mm"}, r"scale must be a positive length \[m\] per unit, got mm"),
        ({"scale": 0.0}, r"scale must be a positive length \[m\] per unit, got 0\.0"),
        ({"fit": "crop"}, "fit must be 'same' or 'scale', got 'crop'"),
        ({"depth_along": "z"}, "depth_along must be 'axis' or 'ray', got 'z'"),
        ({"axes": "ros"}, "axes must be 'opencv' or 'opengl', got 'ros'"),
        ({"missing": 0}, r"missing must be a tuple of numbers, such as \(0, 65535\), got 0"),
        ({"missing": "65535"}, r"missing must be a tuple of numbers, .*, got '65535'"),
        ({"missing": (None,)}, r"missing must be a tuple of numbers, .*, got \(None,\)"),
        ({"grid": (3,)}, r"grid must be columns and rows, two positive whole numbers, got \(3,\)"),
        ({"grid": (0, 5)}, r"grid must be columns and rows, two positive whole numbers, got \(0, 5\)"),
        ({"grid": (6.5, 3)}, r"grid must be columns and rows, two positive whole numbers, got \(6\.5, 3\)"),
        ({"index": 1.5}, "index must be a whole number, got 1.5"),
        ({"image_id": "a"}, "image_id must be a whole number, got 'a'"),
        ({"quarter_turns": "1"}, "quarter_turns must be a whole number, got '1'"),
        ({"crop": ("a", 0, 1, 1)}, r"crop must be \(u0, v0, width, height\) in pixels, got \('a', 0, 1, 1\)"),
        ({"crop": (1, 2)}, r"crop must be \(u0, v0, width, height\) in pixels, got \(1, 2\)"),
    ],
)
def test_options_are_checked(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        ReadOptions(**changes)


def test_options_of_numpy_are_taken() -> None:
    options = ReadOptions(
        index=np.int64(2), grid=(np.int32(4), 3), missing=(np.float32(0), np.nan), scale=np.float32(1)
    )  # type: ignore[arg-type]
    assert options.index == 2


def test_a_camera_matrix_that_is_none_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((4, 6), np.float32))
    with pytest.raises(ValueError, match=r"K must be an array of numbers, got \{'fx': 600\}"):
        read_frame(tmp_path / "a.npy", calibration={"fx": 600})  # type: ignore[arg-type]


@pytest.mark.parametrize("nothing", [np.nan, 0.0])
def test_an_organised_cloud_without_measurements_is_an_empty_frame(tmp_path: Path, nothing: float) -> None:
    np.savez(tmp_path / "a.npz", points=np.full((HEIGHT, WIDTH, 3), nothing))
    frame, report = read_frame_with_report(tmp_path / "a.npz", calibration=K)
    assert (report.source, report.measured_fraction, report.K_residual) == ("organised cloud", 0.0, 0.0)
    assert not frame.valid.any()
    with pytest.raises(ValueError, match="must hold measured points, got none: state K to read it as empty"):
        read_frame(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("name", "changes", "text"),
    [
        (
            "depth.npy",
            {"axes": "opengl"},
            r"axes \(--axes on the command line\) must come with clouds, got a depth image",
        ),
        ("depth.npy", {"grid": (8, 6)}, r"grid \(--grid .* must come with clouds, got a depth image: leave it out"),
        ("depth.npy", {"project": True}, r"project \(--project .* must come with clouds, got a depth image"),
        ("depth.npy", {"index": 3}, r"index \(--index .* must come with recordings, got a file of one frame"),
        ("depth.npy", {"topic": "/d"}, r"topic \(--topic .* must come with recordings, got a file of one frame"),
        ("cloud.npy", {"grey_topic": "/g"}, r"grey_topic \(--grey-topic .* must come with recordings, got a file of"),
        ("cloud.npy", {"missing": (9.0,)}, r"missing \(--missing .* must come with depth images, got a cloud"),
    ],
)
def test_options_that_cannot_apply_are_refused(tmp_path: Path, name: str, changes: dict[str, Any], text: str) -> None:
    np.save(tmp_path / name, scene_points() if name == "cloud.npy" else scene_depth())
    with pytest.raises(ValueError, match=text):
        read_frame(tmp_path / name, calibration=K, options=ReadOptions(**changes))

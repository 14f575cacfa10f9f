"""Calibrations of every format say the same; those that cannot be used are refused."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.capture import Calibration, read_calibration
from perception.capture.yaml_subset import parse_yaml
from tests.perception.capture.camera_files import written

FX, FY, CX, CY = 610.5, 611.25, 320.5, 241.75
K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
D = [-0.25, 0.125, 0.001, -0.002, 0.5]

ROS_1 = f"""image_width: 640
image_height: 480
camera_name: narrow  # of the two
camera_matrix:
  rows: 3
  cols: 3
  data: [{FX}, 0, {CX}, 0, {FY},
         {CY}, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: {D}
"""
ROS_2 = f"""header:
  stamp:
    sec: 12
  frame_id: 'camera_link'
height: 480
width: 640
distortion_model: plumb_bob
d:
{chr(10).join(f"- {value}" for value in D)}
k:
{chr(10).join(f"- {value}" for value in K.ravel())}
roi:
  do_rectify: false
---
height: 1
"""
FLAT = {"fx": FX, "fy": FY, "width": 640, "height": 480}
FILES: dict[str, str] = {
    "ros1.yaml": ROS_1,
    "ros2.yaml": ROS_2,
    "realsense.json": json.dumps({**FLAT, "ppx": CX, "ppy": CY, "coeffs": D, "model": "distortion.brown_conrady"}),
    "nested.json": json.dumps({"depth": {**FLAT, "ppx": CX, "ppy": CY, "coeffs": D}, "serial": "1"}),
    "flat.json": json.dumps({**FLAT, "cx": CX, "cy": CY, **dict(zip(("k1", "k2", "p1", "p2", "k3"), D, strict=True))}),
    "matrix.json": json.dumps({"K": K.tolist(), "distortion": D, "width": 640, "height": 480}),
}


def read(tmp_path: Path, name: str, content: Any, **options: Any) -> Calibration:
    text = content if isinstance(content, str) else json.dumps(content)
    return read_calibration(written(tmp_path / name, text), **options)


@pytest.mark.parametrize("name", FILES)
def test_formats_of_cameras(tmp_path: Path, name: str) -> None:
    calibration = read(tmp_path, name, FILES[name])
    np.testing.assert_allclose(calibration.K, K, rtol=1e-12)
    np.testing.assert_allclose(calibration.distortion[:5], D)
    assert not calibration.distortion[5:].any()
    assert calibration.size == (640, 480)
    assert calibration.depth_scale is None


@pytest.mark.parametrize("suffix", [".yml", ".yaml", ".json"])
def test_files_of_opencv(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"calibration{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array([D]))
    storage.release()
    calibration = read_calibration(path)
    np.testing.assert_array_equal(calibration.K, K)
    np.testing.assert_array_equal(calibration.distortion, D)
    assert calibration.size == (640, 480)


def test_open3d_writes_columns_and_units_per_metre(tmp_path: Path) -> None:
    content = {"width": 640, "height": 480, "intrinsic_matrix": K.T.ravel().tolist(), "depth_scale": 4000.0}
    calibration = read(tmp_path, "a.json", content)
    np.testing.assert_array_equal(calibration.K, K)
    assert calibration.depth_scale == 0.00025


@pytest.mark.parametrize(
    ("unit", "length"),
    [({"depth_scale": 0.0001}, 0.0001), ({"depth_units": 0.0005}, 0.0005), ({"metres_per_unit": 0.002}, 0.002)],
)
def test_units_of_realsense_and_of_written_frames_are_metres(
    tmp_path: Path, unit: dict[str, float], length: float
) -> None:
    assert read(tmp_path, "a.json", {**FLAT, "ppx": CX, "ppy": CY, **unit}).depth_scale == length


def test_bop_states_millimetres_and_one_camera_for_each_image(tmp_path: Path) -> None:
    camera = read(tmp_path, "camera.json", {**FLAT, "cx": CX, "cy": CY, "depth_scale": 0.1})
    np.testing.assert_array_equal(camera.K, K)
    assert camera.depth_scale == pytest.approx(0.0001)
    pose = {"cam_R_w2c": np.diag([1.0, -1, -1]).ravel().tolist(), "cam_t_w2c": [0.0, 0.0, 900.0]}
    scene = {
        "0": {"cam_K": np.eye(3).ravel().tolist()},
        "17": {"cam_K": K.ravel().tolist(), "depth_scale": 0.5, **pose},
    }
    camera = read(tmp_path, "scene_camera.json", scene, image_id=17)
    np.testing.assert_array_equal(camera.K, K)
    assert camera.depth_scale == 0.0005
    assert camera.T_world_cam is not None
    np.testing.assert_allclose(camera.T_world_cam[:3, 3], [0, 0, 0.9], atol=1e-15)
    with pytest.raises(
        ValueError, match=r"image_id must be one of the 2 images of scene_camera\.json, 0 to 17, got None"
    ):
        read(tmp_path, "scene_camera.json", scene)
    np.testing.assert_array_equal(read(tmp_path, "one.json", {"17": scene["17"]}).K, K)


def azure(**changes: float) -> dict[str, Any]:
    values = {"cx": 0.5, "cy": 0.25, "fx": 0.5, "fy": 0.5, "k": 0.1, "codx": 0.0} | changes
    parameters = [*(values[key] for key in ("cx", "cy", "fx", "fy")), *[values["k"] * i for i in range(1, 7)]]
    parameters += [values["codx"], 0.0, 0.002, 0.001, 1.7]  # codx, cody, p2, p1, metric radius
    cameras = [
        {"Location": f"CALIBRATION_CameraLocation{name}", "Intrinsics": {"ModelParameters": parameters}}
        for name in ("D0", "PV0")
    ]
    return {"CalibrationInformation": {"Cameras": cameras}}


@pytest.mark.parametrize(
    ("size", "wanted"),
    [  # the sensor's share of the parameters, less the crop, less half a pixel: pixel centres are whole numbers
        ((640, 576), (512.0, 512.0, 512 - 192 - 0.5, 256 - 180 - 0.5)),
        ((320, 288), (256.0, 256.0, 256 - 96 - 0.5, 128 - 90 - 0.5)),
        ((1920, 1080), (960.0, 720.0, 960 - 0.5, 360 - 180 - 0.5)),
    ],
)
def test_the_azure_kinects_mode_follows_from_the_size(
    tmp_path: Path, size: tuple[int, int], wanted: tuple[float, ...]
) -> None:
    camera = read(tmp_path, "azure.json", azure(), size=size)
    assert (*camera.K[[0, 1], [0, 1]], *camera.K[:2, 2]) == wanted
    np.testing.assert_allclose(camera.distortion, [0.1, 0.2, 0.001, 0.002, 0.3, 0.4, 0.5, 0.6])
    assert camera.depth_scale == 0.001


def test_an_azure_kinect_has_no_other_modes(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must have a mode's size \(640 x 576, .*got \(640, 480\)"):
        read(tmp_path, "azure.json", azure(), size=(640, 480))
    with pytest.raises(ValueError, match=r"centre of distortion must be 0, got 0\.5, 0\.0"):
        read(tmp_path, "azure.json", azure(codx=0.5), size=(640, 576))


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("a.json", "{", r"a\.json must be a complete file of the format that \.json says, but cannot be read"),
        (
            "a.yaml",
            "no mapping",
            r"^a\.yaml: a line of a calibration in YAML must be 'key: value', got 'no map",
        ),
        ("a.yaml", "a: 1\n  b: 2", "must be 'key: value', got 'b: 2'"),
        (
            "a.yaml",
            "camera_matrix: [600, 0, 3,\n 0, 600",
            r"must end with '\]', got 'camera_matrix: \[600, 0, 3, 0, 600'",
        ),
        ("a.xml", "<?xml version='1.0'?>", r"a\.xml must be a calibration in JSON or YAML, got XML: write it with"),
        (
            "a.json",
            '{"fx": 600,\n}',
            r"a\.json must be .*\(JSONDecodeError: .* line \d column \d+ .*\): correct it there, copy",
        ),
        ("a.json", "[1]", "a.json must hold named values, got a list"),
        ("a.json", "{}", r"a.json must hold a camera matrix as one of RealSense .*, got the keys \[\]"),
        (
            "a.yaml",
            ROS_1.replace("plumb_bob", "equidistant"),
            r"must have a lens model of OpenCV's formula .*got 'equidistant' with coefficients \[-0.25",
        ),
    ],
)
def test_files_that_cannot_be_used_are_refused(tmp_path: Path, name: str, content: str, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        read(tmp_path, name, content)


def test_a_lens_model_without_distortion_is_any(tmp_path: Path) -> None:
    content = {**FLAT, "ppx": CX, "ppy": CY, "coeffs": [0.0] * 5, "model": "Inverse Brown Conrady"}
    assert not read(tmp_path, "a.json", content).distortion.any()


def test_yaml_is_read_as_opencv_reads_it(tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(written(tmp_path / "ros.yaml", ROS_1)), cv2.FILE_STORAGE_READ)
    node = storage.getNode("camera_matrix").getNode("data")
    ours = parse_yaml(ROS_1)
    assert ours["camera_matrix"]["data"] == [node.at(i).real() for i in range(node.size())]
    assert ours["distortion_model"] == storage.getNode("distortion_model").string()
    assert ours["camera_name"] == "narrow"  # OpenCV keeps the comment
    assert parse_yaml("a:\nb: []\nc:\n  - x") == {"a": None, "b": [], "c": ["x"]}
    assert parse_yaml("") == {}


def test_a_binary_file_is_no_calibration(tmp_path: Path) -> None:
    np.save(tmp_path / "K.npy", np.eye(3))
    with pytest.raises(ValueError, match=r"K\.npy must be a calibration in JSON or YAML, got a binary file: write"):
        read_calibration(tmp_path / "K.npy")


@pytest.mark.parametrize(
    ("unit", "length"),
    [
        *[(name, 1.0) for name in ("m", "metre", "Meters", " M ")],
        *[(name, 0.001) for name in ("mm", "millimetre", "Millimeters", "1 mm", "1.0mm")],
        *[(name, 1e-6) for name in ("um", "\u00b5m", "\u03bcm", "micrometre")],
        ("0.1 mm", 0.0001),
        ("25e-2mm", 0.00025),
        (".5 cm", 0.005),
    ],
)
@pytest.mark.parametrize("form", ["realsense", "bop", "open3d"])
@pytest.mark.parametrize("key", ["depth_scale", "depth_units", "metres_per_unit"])
def test_a_unit_by_name_says_itself_what_it_is(tmp_path: Path, unit: str, length: float, form: str, key: str) -> None:
    cameras = {
        "realsense": {**FLAT, "ppx": CX, "ppy": CY},
        "bop": {"cam_K": K.ravel().tolist()},
        "open3d": {"intrinsic_matrix": K.T.ravel().tolist()},
    }
    assert read(tmp_path, "a.json", {**cameras[form], key: unit}).depth_scale == pytest.approx(length, rel=1e-12)


def test_numbers_in_quotes_are_numbers(tmp_path: Path) -> None:
    content = {"fx": str(FX), "fy": str(FY), "cx": str(CX), "cy": str(CY), "width": "640", "height": "480.0"}
    calibration = read(tmp_path, "a.json", {**content, "depth_scale": "0.1"})
    np.testing.assert_array_equal(calibration.K, K)
    assert calibration.size == (640, 480)
    assert calibration.depth_scale == pytest.approx(0.0001)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"depth_scale": "inch"},
            "depth_scale must be a number, or a length such as 'mm' or '0.1 mm' in one of m, ",
        ),
        ({"depth_scale": "1/1000"}, "depth_scale must be a number, or a length such as .* got '1/1000'"),
        ({"depth_scale": "-1 mm"}, "depth_scale must be positive and finite, got '-1 mm'"),
        ({"depth_scale": "1e"}, "depth_scale must be a number, got '1e'"),
        ({"depth_scale": 0}, "depth_scale must be positive and finite, got 0"),
        ({"depth_scale": float("nan")}, "depth_scale must be positive and finite, got nan"),
        ({"depth_scale": [0.001]}, r"depth_scale must be a number, got \[0.001\]"),
        ({"depth_scale": True}, "depth_scale must be a number, got True"),
        ({"depth_units": {}}, r"depth_units must be a number, got \{\}"),
        ({"fx": "wide"}, "fx must be a number, got 'wide'"),
        ({"width": "full"}, "width must be a number, got 'full'"),
        ({"width": 640.5}, "width must be a whole number of pixels, got 640.5"),
        ({"distortion": ["k1"]}, r"distortion must be an array of numbers, got \['k1'\]"),
        ({"T_world_cam": "base"}, "T_world_cam must be an array of numbers, got 'base'"),
        ({"K": [["a"] * 3] * 3}, "K must be an array of numbers, got"),
        ({"cam_R_w2c": "up", "cam_t_w2c": [0, 0, 1]}, "rotation must be an array of numbers, got 'up'"),
        (
            {"cam_R_w2c": [1, 2], "cam_t_w2c": [0, 0, 1]},
            "rotation and translation must have 9 and 3 numbers, got 2",
        ),
    ],
)
def test_text_where_a_number_must_be_is_no_damage(tmp_path: Path, changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=rf"^a\.json: {text}"):
        read(tmp_path, "a.json", {**FLAT, "cx": CX, "cy": CY, **changes})


def test_a_unit_in_yaml_may_be_a_name(tmp_path: Path) -> None:
    text = f"fx: {FX}\nfy: {FY}\ncx: {CX}\ncy: {CY}\ndepth_scale: 0.1 mm\n"
    assert read(tmp_path, "a.yaml", text).depth_scale == pytest.approx(0.0001)

"""ROS bags, MCAP and recordings of RealSense cameras."""

import importlib.util
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.capture import Calibration, ReadOptions, frame_count, is_recording, read_frame, read_frame_with_report
from tests.perception.capture.bags import Entry, K, Kind, Messages

DEPTH_MM = np.random.default_rng(0).integers(500, 1500, (48, 64)).astype(np.uint16)
DEPTH_MM[:3] = 0
GREY = np.random.default_rng(1).integers(0, 256, (48, 64)).astype(np.uint8)
KINDS: tuple[Kind, ...] = ("ros1", "sqlite3", "mcap")


def depth_camera(make: Messages) -> list[Entry]:
    """Return a depth image of a camera and its calibration."""
    return [("/d/image", 1, make.image(DEPTH_MM, "16UC1")), ("/d/camera_info", 1, make.info())]


def bag(folder: Path, kind: Kind, *, nodes: int = 1) -> Path:
    """Return the recording of a ROS driver: three depth images, grey images, and calibrations of two cameras."""
    make = Messages(kind)
    entries: list[Entry] = [
        ("/camera/color/camera_info", 1, make.info((128, 96), camera=2 * K)),
        ("/camera/depth/camera_info", 1, make.info()),
    ]
    for k in range(3):
        entries.append(("/camera/depth/image_raw", 1000 * k + 5, make.image(DEPTH_MM + k, "16UC1", padding=8)))
        entries.append(("/camera/ir/image_raw", 1000 * k + 9, make.image(GREY // (k + 1), "mono8")))
        entries.append(("/camera/color/image_raw", 1000 * k + 9, make.image(np.zeros((96, 128, 3), np.uint8), "rgb8")))
    return make.write(folder / ("a.bag" if kind == "ros1" else "a"), entries, nodes=nodes)


@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_has_the_depth_the_registered_grey_and_the_calibration_of_its_time(kind: Kind, tmp_path: Path) -> None:
    path = bag(tmp_path, kind)
    assert is_recording(path)
    assert frame_count(path) == 3
    for index in (0, 2, -1):
        frame = read_frame(path, options=ReadOptions(index=index))
        k = index % 3
        expected = np.where(DEPTH_MM + k > 0, (DEPTH_MM + k) * 0.001, 0).astype(np.float32)
        np.testing.assert_array_equal(frame.depth, expected)
        np.testing.assert_array_equal(frame.grey, GREY // (k + 1))
        np.testing.assert_array_equal(frame.K, K)


def test_a_topic_of_several_nodes_is_one_topic(tmp_path: Path) -> None:
    path = bag(tmp_path, "ros1", nodes=2)
    assert frame_count(path) == 3
    frames = [read_frame(path, options=ReadOptions(index=index)) for index in range(3)]
    assert [round(1000 * float(frame.depth[-1, -1])) - int(DEPTH_MM[-1, -1]) for frame in frames] == [0, 1, 2]
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.grey, GREY // (k + 1))


def test_a_single_mcap_file_is_read(tmp_path: Path) -> None:
    (path,) = bag(tmp_path, "mcap").glob("*.mcap")
    assert read_frame(path).depth.shape == (48, 64)


def test_floating_point_depth_is_in_metres_in_either_byte_order(tmp_path: Path) -> None:
    metres = np.where(DEPTH_MM > 0, DEPTH_MM / 1000, np.nan).astype(np.float32)
    make = Messages("mcap")
    for big in (False, True):
        entries = [("/d/image", 1, make.image(metres, "32FC1", big=big)), ("/d/camera_info", 1, make.info())]
        frame = read_frame(make.write(tmp_path / f"{big}", entries))
        np.testing.assert_array_equal(frame.depth, np.nan_to_num(metres))


def test_a_colour_image_of_another_camera_is_not_taken_but_can_be_named(tmp_path: Path) -> None:
    make = Messages("mcap")
    red = np.zeros((48, 64, 3), np.uint8)
    red[..., 0] = 200
    entries = [
        *depth_camera(make),
        ("/c/image", 2, make.image(red, "rgb8", frame="elsewhere")),
    ]
    path = make.write(tmp_path / "a", entries)
    assert read_frame_with_report(path)[1].grey == "none"
    frame, report = read_frame_with_report(path, options=ReadOptions(grey_topic="/c/image"))
    assert report.grey == "image"
    assert np.unique(frame.grey).tolist() == [60]  # 0.299 of 200
    with pytest.raises(ValueError, match="must have images of the topic /e, got /d/image, /c/image"):
        read_frame(path, options=ReadOptions(grey_topic="/e"))


def test_of_two_registered_images_none_is_taken(tmp_path: Path) -> None:
    make = Messages("mcap")
    entries = [
        *depth_camera(make),
        ("/left/image", 2, make.image(GREY, "mono8")),
        ("/right/image", 2, make.image(GREY, "mono8")),
    ]
    assert read_frame_with_report(make.write(tmp_path / "two", entries))[1].grey == "none"
    assert read_frame_with_report(make.write(tmp_path / "one", entries[:-1]))[1].grey == "image"


def test_a_depth_image_of_16_bits_is_not_its_own_grey_image(tmp_path: Path) -> None:
    make = Messages("mcap")
    entries = [
        ("/d/image", 1, make.image(DEPTH_MM, "mono16")),
        ("/d/camera_info", 1, make.info()),
        ("/d/filtered", 1, make.image(DEPTH_MM, "mono16")),  # nothing says that it is no depth
    ]
    options = ReadOptions(topic="/d/image")
    for count in (2, 3):
        path = make.write(tmp_path / f"{count}", entries[:count])
        assert read_frame_with_report(path, options=options)[1].grey == "none"
    entries.append(("/ir/image", 1, make.image(GREY, "mono8")))
    frame = read_frame(make.write(tmp_path / "grey", entries), options=options)
    np.testing.assert_array_equal(frame.grey, GREY)


def test_images_that_cannot_be_read_are_refused_only_where_they_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    make = Messages("mcap")
    entries = [
        *depth_camera(make),
        ("/raw/image", 2, make.image(GREY, "bayer_rggb8")),
        ("/ir/image", 2, make.image(GREY, "mono8")),
    ]
    for count, grey in ((3, "none"), (4, "image")):
        path = make.write(tmp_path / f"{count}", entries[:count])
        caplog.clear()
        with caplog.at_level("INFO"):
            assert read_frame_with_report(path)[1].grey == grey
        assert "/raw/image is not taken as the grey image: its encoding is bayer_rggb8" in caplog.text
        with pytest.raises(ValueError, match=r"/raw/image must have one of the .* mono8, .*, got 'bayer_rggb8'"):
            read_frame(path, options=ReadOptions(grey_topic="/raw/image"))
    entries[3][2].data = entries[3][2].data[:-10]
    path = make.write(tmp_path / "short", entries)
    assert read_frame_with_report(path)[1].grey == "none"
    assert "there is no grey image: /ir/image must have 48 rows of at least 64 bytes" in caplog.text
    with pytest.raises(ValueError, match="/ir/image must have 48 rows of at least 64 bytes"):
        read_frame(path, options=ReadOptions(grey_topic="/ir/image"))


def test_compressed_depth_has_the_registered_grey_image(tmp_path: Path) -> None:
    make = Messages("mcap")
    png = b"\0" * 12 + cv2.imencode(".png", DEPTH_MM)[1].tobytes()
    entries = [
        ("/d/image/compressedDepth", 1, make.compressed(png, "16UC1; compressedDepth png")),
        ("/d/camera_info", 1, make.info()),
        ("/ir/image", 2, make.image(GREY, "mono8")),
        ("/color/image", 2, make.image(np.zeros((96, 128, 3), np.uint8), "rgb8")),
    ]
    frame, report = read_frame_with_report(make.write(tmp_path / "a", entries))
    assert report.grey == "image"
    np.testing.assert_array_equal(frame.grey, GREY)


def test_compressed_grey_images_are_taken_where_they_are_named(tmp_path: Path) -> None:
    make = Messages("mcap")
    png = cv2.imencode(".png", GREY)[1].tobytes()
    entries = [
        *depth_camera(make),
        ("/ir/image/compressed", 2, make.compressed(png, "mono8; png compressed")),
    ]
    path = make.write(tmp_path / "a", entries)
    assert read_frame_with_report(path)[1].grey == "none"
    frame = read_frame(path, options=ReadOptions(grey_topic="/ir/image/compressed"))
    np.testing.assert_array_equal(frame.grey, GREY)
    with pytest.raises(ValueError, match="compressed must hold compressedDepth images, got compressed images of 'mono"):
        read_frame(path, options=ReadOptions(topic="/ir/image/compressed"))


def test_depth_images_are_preferred_to_the_cloud_of_the_same_camera(tmp_path: Path) -> None:
    make = Messages("mcap")
    table = np.zeros((48, 64), np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4")]))
    for k, name in enumerate(("x", "y", "z")):
        table[name] = points_of(DEPTH_MM / 500.0)[..., k]
    entries = [
        ("/d/points", 1, make.cloud(table)),
        *depth_camera(make),
    ]
    path = make.write(tmp_path / "53", entries)
    frame, report = read_frame_with_report(path)
    assert report.source == "depth image"
    np.testing.assert_allclose(frame.depth, DEPTH_MM / 1000, rtol=1e-6)
    cloud, report = read_frame_with_report(path, options=ReadOptions(topic="/d/points"))
    assert report.source == "organised cloud"
    np.testing.assert_allclose(cloud.depth, DEPTH_MM / 500, rtol=1e-6)
    with pytest.raises(ValueError, match=r"^53: grey_topic must come with a topic of depth .* of /d/points,"):
        read_frame(path, options=ReadOptions(topic="/d/points", grey_topic="/d/image"))


def test_rectified_images_have_the_projection_matrix_and_no_distortion(tmp_path: Path) -> None:
    make = Messages("mcap")
    info = make.info(projection=1.5 * K * [[1], [1], [1 / 1.5]], distortion=np.array([0.2, 0, 0, 0, 0]))
    for topic, focal, undistorted in (("/d/image_rect", 90.0, False), ("/d/image_raw", 60.0, True)):
        entries = [(topic, 1, make.image(DEPTH_MM, "16UC1")), ("/d/camera_info", 1, info)]
        frame, report = read_frame_with_report(make.write(tmp_path / topic[3:], entries))
        assert (frame.K[0, 0], report.undistorted) == (focal, undistorted)


@pytest.mark.parametrize("old", [True, False])
def test_recordings_of_librealsense_state_their_unit(old: bool, tmp_path: Path) -> None:
    make = Messages("ros1" if old else "sqlite3")
    sensor = "/device_0/sensor_0"
    if old:  # up to 2.56
        entries = [
            (f"{sensor}/Depth_0/image/data", 5, make.image(DEPTH_MM, "mono16")),
            (f"{sensor}/Depth_0/info/camera_info", 0, make.info()),
            (f"{sensor}/option/Depth Units/value", 0, make.number(0.00025)),
        ]
    else:
        text = "width=64;height=48;fx=60;ppx=31.5;fy=61;ppy=23.5;model=Brown Conrady;coeffs=0,0,0,0,0"
        png = b"\0" * 12 + cv2.imencode(".png", DEPTH_MM)[1].tobytes()
        entries = [
            (f"{sensor}/Depth_0/image/data/compressedDepth", 5, make.compressed(png, "16UC1; compressedDepth png")),
            (f"{sensor}/Depth_0/camera_info", 0, make.text(text)),
            (f"{sensor}/option/Depth_Units/value", 0, make.text("0.000250")),
        ]
    entries += [
        (f"{sensor}/Infrared_1/image/data", 5, make.image(GREY, "mono8")),
        (f"{sensor}/Infrared_1/info/camera_info", 0, make.info()),
    ]
    path = make.write(tmp_path / ("a.bag" if old else "a"), entries)
    frame, report = read_frame_with_report(path)
    np.testing.assert_allclose(frame.depth, DEPTH_MM * 0.00025, rtol=1e-6)
    np.testing.assert_array_equal(frame.K, K)
    assert report.grey == "none"  # infrared shows the projector's dots
    other = read_frame(path, calibration=2 * K * [[1], [1], [0.5]])  # whose own unit is not known
    np.testing.assert_array_equal(other.depth, frame.depth)
    assert other.K[0, 0] == 120
    stated = read_frame(path, calibration=Calibration(K=K, depth_scale=0.0005))
    np.testing.assert_allclose(stated.depth, DEPTH_MM * 0.0005, rtol=1e-6)


def test_of_several_sensors_the_unit_is_that_of_the_one_that_recorded_the_depth(tmp_path: Path) -> None:
    make = Messages("mcap")
    entries = [
        ("/device_0/sensor_1/Depth_0/image/data", 1, make.image(DEPTH_MM, "mono16")),
        ("/device_0/sensor_0/option/Depth_Units/value", 1, make.number(0.001)),
        ("/device_0/sensor_1/option/Depth_Units/value", 1, make.number(0.00025)),
    ]
    path = make.write(tmp_path / "own", entries)
    np.testing.assert_allclose(read_frame(path, calibration=K).depth, DEPTH_MM * 0.00025, rtol=1e-6)
    entries[0] = ("/device_0/sensor_2/Depth_0/image/data", 1, entries[0][2])
    path = make.write(tmp_path / "others", entries)
    with pytest.raises(ValueError, match=r"one unit of .*/sensor_2/.* 0\.001 m in .*, 0\.00025 m in .* scale="):
        read_frame(path, calibration=K)
    stated = read_frame(path, calibration=K, options=ReadOptions(scale=0.0005))
    np.testing.assert_allclose(stated.depth, DEPTH_MM * 0.0005, rtol=1e-6)


def points_of(depth: np.ndarray) -> np.ndarray:
    v, u = np.indices(depth.shape)
    return np.dstack([(u - K[0, 2]) / K[0, 0] * depth, (v - K[1, 2]) / K[1, 1] * depth, depth])


def test_an_organised_cloud_gives_its_camera(tmp_path: Path) -> None:
    make = Messages("sqlite3")
    layout = {"names": ["x", "y", "z", "rgb"], "formats": 4 * ["f4"], "offsets": [0, 4, 8, 16], "itemsize": 32}
    table = np.zeros((48, 64), np.dtype(layout))  # the layout of PCL
    points = points_of(DEPTH_MM / 1000.0)
    points[DEPTH_MM == 0] = np.nan
    for k, name in enumerate(("x", "y", "z")):
        table[name] = points[..., k]
    packed = (GREY.astype(np.uint32) * 0x010101) | np.uint32(0xFF000000)
    table["rgb"] = packed.view(np.float32)  # NaN where red >= 128
    frame, report = read_frame_with_report(make.write(tmp_path / "a", [("/points", 1, make.cloud(table, padding=16))]))
    assert (report.source, report.K_recovered, report.grey) == ("organised cloud", True, "cloud")
    np.testing.assert_allclose(frame.K, K, atol=1e-3)
    np.testing.assert_allclose(frame.depth, DEPTH_MM / 1000, atol=1e-6)
    np.testing.assert_array_equal(frame.grey, GREY)


def test_what_a_recording_lacks_is_told(tmp_path: Path) -> None:
    make = Messages("mcap")
    image, info = make.image(DEPTH_MM, "16UC1"), make.info()
    two = make.write(tmp_path / "two", [("/a/d", 1, image), ("/b/d", 1, image), ("/b/camera_info", 1, info)])
    with pytest.raises(ValueError, match="one topic of depth images or clouds, got the 2 topics /a/d, /b/d: name one"):
        read_frame(two)
    assert read_frame(two, options=ReadOptions(topic="/b/d")).depth.shape == (48, 64)
    with pytest.raises(ValueError, match=r"two must have the topic /c, got /a/d \(Image\), /b/d \(Image\)"):
        read_frame(two, options=ReadOptions(topic="/c"))
    none = make.write(tmp_path / "none", [("/b/camera_info", 1, info)])
    with pytest.raises(ValueError, match=r"got only /b/camera_info \(CameraInfo\)"):
        read_frame(none)
    text = "topic /b/camera_info of two must hold depth images or clouds, got CameraInfo: name another one of /a/d"
    with pytest.raises(ValueError, match=text):
        read_frame(two, options=ReadOptions(topic="/b/camera_info"))
    one = make.write(tmp_path / "one", [("/a/d", 1, image)])
    with pytest.raises(ValueError, match="index must be one of the 1 frames of one, 0 to 0, got 3"):
        read_frame(one, options=ReadOptions(index=3))
    with pytest.raises(ValueError, match="the depth image one needs a calibration"):
        read_frame(one)
    assert read_frame(one, calibration=K).depth.shape == (48, 64)
    with pytest.raises(ValueError, match="/a/d must have the encoding 16UC1 or 32FC1 of depth, got 'mono8'"):
        read_frame(
            make.write(tmp_path / "g", [("/a/d", 1, make.image(GREY, "mono8"))]), options=ReadOptions(topic="/a/d")
        )
    with pytest.raises(FileNotFoundError, match=r"there is no recording .*lost\.mcap"):
        read_frame(tmp_path / "lost.mcap")


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_topic_without_messages_is_named(kind: Kind, tmp_path: Path) -> None:
    path = Messages(kind).write(tmp_path / ("a.bag" if kind == "ros1" else "a"), [], empty=("/a/d",))
    assert frame_count(path, "/a/d") == 0
    with pytest.raises(ValueError, match=r"the topic /a/d of a(\.bag)? must hold depth images or clouds, got none"):
        read_frame(path, options=ReadOptions(topic="/a/d"))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"binning_x": 2}, "must be of a whole image without binning"),
        ({"x_offset": 8}, "must be of a whole image without binning"),
        ({"y_offset": 8}, "must be of a whole image without binning"),
        ({"distortion_model": "equidistant", "distortion": np.full(4, 0.1)}, "must have a lens model of OpenCV's"),
        ({"camera": np.zeros((3, 3))}, "K must be finite with positive focal lengths"),
    ],
)
def test_calibrations_that_cannot_be_used_are_refused_unless_another_is_given(
    changes: dict[str, Any], text: str, tmp_path: Path
) -> None:
    make = Messages("mcap")
    entries = [("/a/d", 1, make.image(DEPTH_MM, "16UC1")), ("/a/camera_info", 1, make.info(**changes))]
    path = make.write(tmp_path / "a", entries)
    with pytest.raises(ValueError, match=rf"{text}.*pass it by calibration= \(--calibration on the command line\)"):
        read_frame(path)
    np.testing.assert_array_equal(read_frame(path, calibration=2 * K * [[1], [1], [0.5]]).K[:2], 2 * K[:2])


def test_calibrations_of_another_size_do_not_stop_the_reading(tmp_path: Path) -> None:
    make = Messages("mcap")
    fisheye = {"distortion_model": "equidistant", "distortion": np.full(4, 0.1)}
    image, large = make.image(DEPTH_MM, "16UC1"), make.info((128, 96), **fisheye)
    fitting, binned = make.info(), make.info((128, 96), binning_x=2, binning_y=2)  # of 64 x 48 pixels
    for name, infos in (
        ("farther", {"/a/b/camera_info": large, "/a/camera_info": fitting}),
        ("alike", {"/a/b/camera_info": binned, "/a/b/depth/camera_info": fitting}),
    ):
        entries = [("/a/b/d", 1, image), *((topic, 1, info) for topic, info in infos.items())]
        np.testing.assert_array_equal(read_frame(make.write(tmp_path / name, entries)).K, K)
    # Where the images' own calibration cannot be used, another camera's does not take its place.
    for own in (binned, make.info(**fisheye)):
        entries = [("/a/b/d", 1, image), ("/a/b/camera_info", 1, own), ("/a/c/camera_info", 1, fitting)]
        with pytest.raises(ValueError, match=r"/a/b/camera_info.*pass it by calibration="):
            read_frame(make.write(tmp_path / f"own {own.binning_x}", entries))
    with pytest.raises(ValueError, match=r"/a/camera_info must have a lens model.*pass it by calibration="):
        read_frame(make.write(tmp_path / "large", [("/a/d", 1, image), ("/a/camera_info", 1, large)]))


def test_damaged_recordings_are_refused_by_name(tmp_path: Path) -> None:
    (path,) = bag(tmp_path, "mcap").glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"cut\.mcap must be a complete file"):
        read_frame(cut)
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: 1")
    with pytest.raises(ValueError, match="folder must be a complete recording, but cannot be read"):
        read_frame(folder)
    make = Messages("mcap")
    message = make.image(DEPTH_MM, "16UC1")
    message.data = message.data[:-10]
    with pytest.raises(ValueError, match=r"short: /a/d must have 48 rows of at least 128 bytes, got .* 6134 bytes"):
        read_frame(make.write(tmp_path / "short", [("/a/d", 1, message)]))
    png = make.compressed(b"nothing", "16UC1; compressedDepth png")
    with pytest.raises(ValueError, match="must hold 16-bit PNG images, got '16UC1; compressedDepth png'"):
        read_frame(make.write(tmp_path / "png", [("/a/d", 1, png)]))


def test_without_rosbags_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "binpick\[cameras\]"'):
        read_frame(tmp_path / "a.bag")

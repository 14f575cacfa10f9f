"""Live cameras: any driver's points, and RealSense through its software device."""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from perception.capture import Camera, PointsCamera, ReadOptions, RealSenseCamera
from perception.geometry import make_transform, rotation_about

K = np.array([[60.0, 0, 31.5], [0, 61.0, 23.5], [0, 0, 1]])
DEPTH = np.random.default_rng(0).uniform(0.5, 1.0, (48, 64))
POSE = make_transform(rotation_about((1.0, 0.0, 0.0), np.pi), (0.1, 0.2, 0.9))
RED = np.zeros((48, 64, 3), np.uint8)
RED[..., 0] = 200


def points() -> np.ndarray:
    v, u = np.indices(DEPTH.shape)
    grid = np.dstack([(u - K[0, 2]) / K[0, 0] * DEPTH, (v - K[1, 2]) / K[1, 1] * DEPTH, DEPTH])
    grid[:4] = np.nan
    return grid


@pytest.mark.parametrize("millimetres", [False, True])
def test_the_points_of_any_driver_become_a_frame(millimetres: bool) -> None:
    scale = 1000.0 if millimetres else 1.0
    camera: Camera = PointsCamera(
        grab=lambda: ((scale * points()).astype(np.float32), RED),
        T_world_cam=POSE.tolist(),  # type: ignore[arg-type]
        options=ReadOptions(scale=1 / scale),
    )
    frame = camera.capture()
    np.testing.assert_allclose(frame.depth[4:], DEPTH[4:], rtol=1e-6)
    assert not frame.valid[:4].any()
    np.testing.assert_allclose(frame.K, K, atol=1e-3)
    np.testing.assert_array_equal(frame.T_world_cam, POSE)
    assert np.unique(frame.grey).tolist() == [60]  # 0.299 of 200


def test_points_alone_have_no_grey_image() -> None:
    assert not PointsCamera(grab=points).capture().grey.any()


def test_points_that_are_no_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match="points must be an array of numbers, got"):
        PointsCamera(grab=lambda: np.full((3, 4, 3), "a")).capture()


def test_points_without_a_grid_are_refused() -> None:
    with pytest.raises(ValueError, match=r"grab must return an \(H, W, 3\) array of points, got \(9, 3\): keep"):
        PointsCamera(grab=lambda: np.zeros((9, 3))).capture()


@pytest.fixture
def software() -> Callable[[float], Callable[[], Any]]:
    """Return a source of the frames of librealsense's software device, for a unit of depth [m]; 0 sets none."""
    rs: Any = pytest.importorskip("pyrealsense2", exc_type=ImportError)

    def source(unit: float) -> Callable[[], Any]:
        height, width = DEPTH.shape
        device = rs.software_device()
        sensor = device.add_sensor("Stereo")
        lens = rs.intrinsics()
        lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy = width, height, K[0, 0], K[1, 1], 31.5, 23.5
        lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.0] * 5
        stream = rs.video_stream()
        stream.type, stream.fmt, stream.intrinsics = rs.stream.depth, rs.format.z16, lens
        stream.index, stream.uid, stream.width, stream.height, stream.fps, stream.bpp = 0, 0, width, height, 30, 2
        profile = sensor.add_video_stream(stream)
        if unit > 0:
            sensor.add_read_only_option(rs.option.depth_units, unit)
        queue = rs.syncer()
        sensor.open(profile)
        sensor.start(queue)
        shot = rs.software_video_frame()
        shot.stride, shot.bpp, shot.timestamp, shot.frame_number = 2 * width, 2, 1.0, 1
        shot.domain, shot.profile = rs.timestamp_domain.hardware_clock, profile.as_video_stream_profile()
        shot.pixels, shot.depth_units = np.rint(DEPTH / 0.0005).astype(np.uint16), unit
        sensor.on_video_frame(shot)
        return lambda device=device: queue.wait_for_frames(2000)  # the device must live as long

    return source


def test_a_realsense_gives_its_depth_and_its_camera(software: Callable[[float], Callable[[], Any]]) -> None:
    frame = RealSenseCamera(software(0.0005), T_world_cam=POSE).capture()
    np.testing.assert_allclose(frame.depth, DEPTH, atol=0.00026)
    np.testing.assert_allclose(frame.K, K)
    np.testing.assert_array_equal(frame.T_world_cam, POSE)


def test_a_realsense_without_a_unit_is_refused(software: Callable[[float], Callable[[], Any]]) -> None:
    with pytest.raises(ValueError, match="must have a unit in metres, got 0: set the option depth_units"):
        RealSenseCamera(software(0.0)).capture()


class Shot:
    """A frame of pyrealsense2, as far as it is read."""

    def __init__(self, data: np.ndarray, form: object = None) -> None:
        self.data, self.form = data, form
        self.profile = self

    def get_data(self) -> np.ndarray:
        return self.data

    def get_units(self) -> float:
        return 0.001

    def format(self) -> object:
        return self.form

    def as_video_stream_profile(self) -> "Shot":
        return self

    @property
    def intrinsics(self) -> Any:
        kind = type("Lens", (), {"width": 64, "height": 48, "fx": 60.0, "fy": 61.0, "ppx": 31.5, "ppy": 23.5})
        kind.model, kind.coeffs = "distortion.brown_conrady", [0.0] * 5  # type: ignore[attr-defined]
        return kind


class Shots:
    def __init__(self, depth: Shot | None, colour: Shot | None) -> None:
        self.depth, self.colour = depth, colour

    def get_depth_frame(self) -> Shot | None:
        return self.depth

    def get_color_frame(self) -> Shot | None:
        return self.colour


def test_aligned_colour_becomes_grey_without_edges_at_holes() -> None:
    rs: Any = pytest.importorskip("pyrealsense2", exc_type=ImportError)
    depth = np.full((48, 64), 800, np.uint16)
    depth[20:30, 20:30] = 0
    colour = np.where(depth[..., None] > 0, RED, 0).astype(np.uint8)
    for pixels, form in ((colour, rs.format.rgb8), (colour[..., ::-1], rs.format.bgr8)):
        frame = RealSenseCamera(lambda p=pixels, f=form: Shots(Shot(depth), Shot(p, f))).capture()
        assert np.unique(frame.grey).tolist() == [60]
    other = Shot(np.zeros((96, 128, 3), np.uint8), rs.format.rgb8)
    assert not RealSenseCamera(lambda: Shots(Shot(depth), other)).capture().grey.any()


def test_a_realsense_without_depth_is_refused() -> None:
    pytest.importorskip("pyrealsense2", exc_type=ImportError)
    with pytest.raises(ValueError, match="the camera must send depth images, got none: enable its depth stream"):
        RealSenseCamera(lambda: Shots(None, None)).capture()


def test_a_missing_library_of_the_system_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyrealsense2 2.59 brings no libusb."""
    missing = ImportError("libusb-1.0.so.0: cannot open shared object file")

    def load(name: str) -> None:
        raise missing

    monkeypatch.setattr("importlib.import_module", load)
    named = r"cannot be loaded: libusb-1\.0\.so\.0: .* apt install libusb-1\.0-0"
    with pytest.raises(ImportError, match=named) as raised:
        RealSenseCamera(lambda: None)
    assert raised.value.__cause__ is missing


def test_without_pyrealsense2_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(ModuleNotFoundError, match=r'needs pyrealsense2: pip install "binpick\[cameras\]"'):
        RealSenseCamera(lambda: None)

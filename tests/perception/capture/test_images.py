"""Images of depth and grey are read as they are stored, and converted as documented."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from perception.capture import images
from perception.capture.images import grey_image, metres, read_raw
from tests.perception.capture.camera_files import written

STORED = np.array([[0, 1, 500], [1000, 65534, 65535]], np.uint16)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".tiff", ".npy"])
def test_sixteen_bits_are_read_unchanged(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"depth{suffix}"
    np.save(path, STORED) if suffix == ".npy" else cv2.imwrite(str(path), STORED)
    raw = read_raw(path)
    assert raw.dtype == np.uint16
    np.testing.assert_array_equal(raw, STORED)


@pytest.mark.parametrize("suffix", [".tiff", ".npy"])
def test_floating_point_is_read_unchanged(tmp_path: Path, suffix: str) -> None:
    depth = np.array([[0.5, np.nan], [np.inf, 0.123456789]], np.float32)
    path = tmp_path / f"depth{suffix}"
    np.save(path, depth) if suffix == ".npy" else cv2.imwrite(str(path), depth)
    np.testing.assert_array_equal(read_raw(path), depth)


def test_integers_are_millimetres_and_missing_values_zero() -> None:
    depth = metres(STORED, None, (0, 65535))
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, np.array([[0, 0.001, 0.5], [1, 65.534, 0]], np.float32))
    np.testing.assert_array_equal(metres(STORED, 0.0001, (500,))[0], np.array([0, 0.0001, 0], np.float32))


def test_floating_point_is_in_metres_and_its_oddities_are_missing() -> None:
    raw = np.array([[np.nan, np.inf, -np.inf, -0.5, 0.0, 0.7, 10.0]], np.float64)
    np.testing.assert_array_equal(metres(raw, None, (10.0, np.nan)), np.array([[0, 0, 0, 0, 0, 0.7, 0]], np.float32))
    single = np.array([[0.1, 0.2]], np.float32)
    np.testing.assert_array_equal(metres(single, None, (0.1,)), np.array([[0, 0.2]], np.float32))
    np.testing.assert_array_equal(metres(raw[..., None], 0.5, ())[0, 5:], np.array([0.35, 5], np.float32))


@pytest.mark.parametrize("largest", [np.finfo(np.float64).max, np.finfo(np.float32).max, 1e30, 1e6])
def test_depths_that_no_camera_has_are_missing(largest: float) -> None:
    np.testing.assert_array_equal(metres(np.array([[largest, 0.7]]), None, (0,)), np.array([[0, 0.7]], np.float32))
    single = np.array([[min(largest, np.finfo(np.float32).max), 700]], np.float32)
    np.testing.assert_array_equal(metres(single, 1.0, (0,)), np.array([[0, 700]], np.float32))  # millimetres as metres
    integers = np.array([[2**32 - 1, 700]], np.uint32)
    np.testing.assert_array_equal(metres(integers, None, (0,)), np.array([[0, 0.7]], np.float32))


def test_depths_that_are_all_too_far_are_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    assert not metres(np.array([[900, 1200, 0]], np.uint16), 1e4, (0,)).any()
    assert "all depths are 1e+06 m or more and count as missing: is scale right" in caplog.text
    caplog.clear()
    metres(np.zeros((1, 2)), None, (0,))
    metres(np.array([[1e30, 0.7]]), None, (0,))
    assert not caplog.text


@pytest.mark.parametrize(
    ("raw", "text"),
    [
        (np.zeros((2, 3, 3), np.uint16), r"must be \(H, W\), got \(2, 3, 3\): this is a picture of a depth image"),
        (np.zeros((2, 3), np.uint8), "must have 16-bit or larger integers or floating point, got uint8"),
        (np.zeros((2, 3), np.complex64), "must have 16-bit or larger integers or floating point, got complex64"),
    ],
)
def test_pictures_of_depth_are_refused(raw: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        metres(raw, None, ())


def test_colour_becomes_grey_as_opencv_does_it(tmp_path: Path) -> None:
    colour = np.random.default_rng(0).integers(0, 256, (4, 5, 3), np.uint8)
    path = tmp_path / "colour.png"
    cv2.imwrite(str(path), colour)
    grey, wanted = grey_image(read_raw(path)), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert np.abs(grey.astype(int) - wanted).max() <= 1  # the PNG decoder truncates, where the conversion rounds
    with_alpha = np.dstack([colour, np.zeros((4, 5), np.uint8)])
    np.testing.assert_array_equal(grey_image(with_alpha), grey_image(colour))
    np.testing.assert_array_equal(grey_image(colour[:, :, :1]), colour[:, :, 0])


@pytest.mark.parametrize(("largest", "shift"), [(200, 0), (1000, 2), (4095, 4), (4096, 6), (65535, 8)])
def test_sixteen_bits_of_grey_hold_their_brightness(largest: int, shift: int) -> None:
    raw = np.array([[0, largest // 2, largest]], np.uint16)
    np.testing.assert_array_equal(grey_image(raw), (raw >> shift).astype(np.uint8))


def test_other_grey_images_are_refused() -> None:
    with pytest.raises(ValueError, match="must be uint8 or uint16, got float32"):
        grey_image(np.zeros((2, 3), np.float32))
    with pytest.raises(ValueError, match=r"must be \(H, W\), \(H, W, 3\) or \(H, W, 4\), got \(2, 3, 2\)"):
        grey_image(np.zeros((2, 3, 2), np.uint8))


@pytest.mark.parametrize("content", [b"", b"no image"])
def test_files_that_are_no_images_are_refused(tmp_path: Path, content: bytes) -> None:
    path = written(tmp_path / "depth.png", content)
    with pytest.raises(ValueError, match=rf"depth.png must be an image that OpenCV reads, got {len(content)} bytes"):
        read_raw(path)


@pytest.mark.parametrize(("enabled", "built"), [("0", True), ("1", False)])
def test_exr_is_refused_with_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, enabled: str, built: bool) -> None:
    monkeypatch.setenv(images.EXR, enabled)
    monkeypatch.setattr(cv2, "haveImageWriter", lambda name: built)
    with pytest.raises(ValueError, match=f"must be read by an OpenCV with .*this is OpenCV .* with {images.EXR}="):
        read_raw(tmp_path / "depth.exr")


def test_exr_is_read_where_opencv_can(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(images.EXR, "1")
    monkeypatch.setattr(cv2, "haveImageWriter", lambda name: True)
    _, encoded = cv2.imencode(".tiff", np.full((2, 3), 0.7, np.float32))  # stands in for the format
    raw = read_raw(written(tmp_path / "depth.exr", encoded.tobytes()))
    np.testing.assert_array_equal(raw, np.full((2, 3), 0.7, np.float32))

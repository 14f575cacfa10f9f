"""Images and calibrations of single messages of ROS."""

import numpy as np
import pytest

from perception.capture.ros_messages import calibration_of_info, grey_of, size_of_info
from tests.perception.capture.bags import Messages

MAKE = Messages("mcap")


@pytest.mark.parametrize(("encoding", "order"), [("rgba8", (0, 1, 2)), ("bgra8", (2, 1, 0))])
def test_colours_with_transparency_are_grey_in_their_order(encoding: str, order: tuple[int, int, int]) -> None:
    pixels = np.full((2, 3, 4), 255, np.uint8)
    for channel, value in zip(order, (200, 100, 50), strict=True):  # red, green, blue
        pixels[..., channel] = value
    pixels[..., 3] = 7  # transparency, which does not count
    assert np.unique(grey_of(MAKE.image(pixels, encoding), "/c")).tolist() == [124]  # 0.299 r + 0.587 g + 0.114 b


@pytest.mark.parametrize(
    ("stated", "taken"),
    [
        ("0,0,0,0,0,0", []),  # a number of coefficients that OpenCV's model does not take
        ("0,0,0,0,0", []),
        ("0.1,-0.2,0.001,0.002,0.03", [0.1, -0.2, 0.001, 0.002, 0.03]),
    ],
)
def test_coefficients_of_librealsense_are_none_where_all_are_zero(stated: str, taken: list[float]) -> None:
    text = f"width=64;height=48;fx=60;ppx=31.5;fy=61;ppy=23.5;model=Brown Conrady;coeffs={stated}"
    calibration = calibration_of_info(MAKE.text(text), "/camera_info", rectified=False)
    assert calibration.distortion.tolist() == taken


def test_encodings_that_are_not_known_are_refused() -> None:
    with pytest.raises(ValueError, match=r"/c must have one of the encodings mono8, .*, got 'yuv422'"):
        grey_of(MAKE.image(np.zeros((2, 3, 2), np.uint8), "yuv422"), "/c")
    with pytest.raises(ValueError, match="/c must hold JPEG or PNG images, got 'jpeg'"):
        grey_of(MAKE.compressed(b"nothing", "jpeg"), "/c")


def test_the_size_of_a_calibration_is_that_of_its_images() -> None:
    region = MAKE.info((128, 96), binning_x=2, binning_y=3)
    region.roi.width, region.roi.height = 40, 60
    assert size_of_info(region) == (20, 20)
    assert size_of_info(MAKE.info((128, 96))) == (128, 96)
    assert size_of_info(MAKE.info((0, 0))) is None
    assert size_of_info(MAKE.text("binwidth=2;width=64;height=48;fx=60")) == (64, 48)
    assert size_of_info(MAKE.text("fx=60")) is None

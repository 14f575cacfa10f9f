"""What a calibration states of the lens is read or refused, and never left out."""

from typing import Any

import numpy as np
import pytest

from perception.capture.lens import distortion_of

D = [-0.1, 0.02, 0.001, -0.002]


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ({}, []),
        ({"distortion_coeffs": D, "distortion_model": "radtan", "camera_model": "pinhole"}, D),
        ({"distortionCoefficients": {"rows": 1, "data": D}, "fisheye_model": 0.0, "model": "plumb_bob"}, D),
        ({"dist": D}, D),
        ({"k2": 0.02, "p1": 0.001}, [0, 0.02, 0.001, 0, 0, 0, 0, 0]),
        ({"distortion": [], "D": D, "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002}, D),
        ({"distance": 0.9, "lens": "8 mm", "distorted": False, "undistorted": None, "k9": 0, "radial": ""}, []),
        ({"model": "Zivid Two", "K1": {"data": np.ones(9)}}, []),
    ],
)
def test_the_lens_is_read(values: dict[str, Any], wanted: list[float]) -> None:
    np.testing.assert_array_equal(distortion_of(values, "a.yaml"), wanted)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"fisheye_model": 1.0, "distortion": D}, "a.yaml states 'fisheye_model', which is about the lens and must"),
        (
            {"distortion_model": "equidistant", "D": [0.0] * 4},
            "must have a lens model of .* got 'equidistant'",
        ),
        ({"camera_model": "omni", "D": []}, "must have a lens model of OpenCV's formula .* got 'omni' with coeff"),
        ({"model": "inverse_brown_conrady", "D": D}, "must have a lens model of OpenCV's .* got 'inverse_brown_conr"),
        ({"K": 1, "s1": 0.1}, "a.yaml states 's1', which is about the lens and must have a known name: .*; got 0.1"),
        ({"radial_distortion": [0.1, 0]}, "a.yaml states 'radial_distortion', which is about the lens"),
        ({"lens_distortion": {"k1": 0.1}}, "a.yaml states 'lens_distortion', which is about the lens"),
        ({"K1": 0.1}, "a.yaml states 'K1', which is about the lens and must have a known name"),
        ({"distortion": {"k1": 0.1}}, r"distortion must be a list of numbers, or have one under data, got the .*'k1'"),
        ({"k2": "a"}, "k2 must be a number, got 'a'"),
        ({"distortion": D, "k1": 0.3}, "a.yaml must state the distortion once, got different values as distortion and"),
    ],
)
def test_what_is_not_understood_is_refused(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        distortion_of(values, "a.yaml")

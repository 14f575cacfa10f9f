"""Holes take the nearest value."""

import numpy as np

from perception.capture.filling import fill_from_nearest


def test_holes_take_the_nearest_grey() -> None:
    image = np.array([[1, 0, 0, 9]], np.uint8)
    assert fill_from_nearest(image, image > 0).tolist() == [[1, 1, 9, 9]]
    assert fill_from_nearest(image, np.ones((1, 4), bool)) is image

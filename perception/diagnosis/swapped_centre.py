"""A principal point whose coordinates are swapped: the poses are good, but lie aside of the parts."""

from dataclasses import replace

import numpy as np

from perception.diagnosis.report import Cause
from perception.diagnosis.samples import DepthSamples
from perception.diagnosis.setup import Setup
from perception.frame import Frame, Workspace
from perception.geometry import Floats

_OBLONG = 1.1  # least ratio of the image's sides with which a swapped principal point stands out from others
# Largest distance of the principal point from the middle of the image with width and height swapped, as a share of the
# longer side: lenses are decentred by up to 3 %. Cropped images have it anywhere, so that less is taken where no bin
# tells which of the two is right.
_NEAR, _NEARER = 0.03, 0.01
_BETTER = 0.02  # least gain of the share of the measurements that lie in the bin's box


def swapped_centre_cause(frame: Frame, believed: Workspace | None) -> Cause | None:
    """Return the cause of swapped coordinates of a frame's principal point; None if they are not.

    Args:
        frame: Frame of the camera.
        believed: The bin as it was believed to be before the frame was seen; None if its place was not known.
    """
    height, width = frame.depth.shape
    if not _is_swapped(frame.K, (width, height), _NEARER if believed is None else _NEAR):
        return None
    if believed is None:
        cause = _cause(frame.K, (width, height))
        return replace(cause, text=f"{cause.text}, unless this image was cut out of a larger one")
    found = swapped_centre(DepthSamples.of(frame), Setup.of(frame, believed))
    return None if found is None else found[0]


def swapped_centre(samples: DepthSamples, setup: Setup) -> tuple[Cause, Setup] | None:
    """Return the cause of swapped coordinates of the principal point, and the setup with the right ones; None if none.

    They are swapped if the principal point is close to the middle of the image with width and height swapped, and the
    measurements fill the bin better with the coordinates swapped back. In a cropped image they do not.
    """
    if not _is_swapped(setup.K, samples.size, _NEAR):
        return None
    K = setup.K.copy()
    K[:2, 2] = K[1::-1, 2]
    other = replace(setup, K=K)
    given, swapped = setup.fit(samples), other.fit(samples)
    if swapped.inside < given.inside + _BETTER or swapped.view < given.view:
        return None
    return _cause(setup.K, samples.size), other


def _is_swapped(K: Floats, size: tuple[int, int], tolerance: float) -> bool:
    width, height = size
    if max(size) < _OBLONG * min(size):
        return False
    away = np.linalg.norm(K[:2, 2] - (np.array([height, width]) - 1) / 2)
    return bool(away <= tolerance * max(size))


def _cause(K: Floats, size: tuple[int, int]) -> Cause:
    width, height = size
    text = (
        f"the principal point ({K[0, 2]:.0f}, {K[1, 2]:.0f}) px is the middle of an image of {height} x {width} px, "
        f"but this one has {width} x {height}: cx and cy of K seem to be swapped, and all poses lie aside of the "
        "parts; swap K[0, 2] and K[1, 2] (in --calibration on the command line)"
    )
    return Cause(name="camera_matrix", text=text)

"""The interface of depth sensors: what a sensor sees, and the depth it measures."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.geometry import Floats, require_shape


@dataclass(frozen=True, eq=False, kw_only=True)
class TrueView:
    """The noise-free view in front of a sensor.

    Attributes:
        depth: (H, W) float32 depth [m], 0 where there is nothing.
        normals: (H, W, 3) float32 unit surface normals in the camera frame, towards the eye.
        grey: (H, W) uint8 grey image: how much light each surface returns.
        K: (3, 3) pinhole matrix [px].
    """

    depth: NDArray[np.float32]
    normals: NDArray[np.float32]
    grey: NDArray[np.uint8]
    K: Floats

    def __post_init__(self) -> None:
        require_shape("depth", self.depth, (None, None))
        require_shape("normals", self.normals, (*self.depth.shape, 3))
        require_shape("grey", self.grey, self.depth.shape)
        require_shape("K", self.K, (3, 3))


@runtime_checkable
class DepthSensor(Protocol):
    """A model of a depth sensor, as `DepthCamera.capture` calls it."""

    def measure(self, view: TrueView, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the measured (H, W) float32 depth [m], 0 where there is no measurement or nothing to measure."""
        ...


def smooth_noise(rng: np.random.Generator, shape: tuple[int, ...], spread: float) -> NDArray[np.float32]:
    """Return (H, W) float32 Gaussian noise of unit variance, correlated over neighbouring pixels.

    White noise is filtered by a Gaussian, so that the correlation of two pixels at distance r is
    ``exp(-r^2 / (4 spread^2))``.

    Args:
        rng: Source of one normal number a pixel.
        shape: Height and width.
        spread: Standard deviation of the filter [px]; 0 leaves the noise white.
    """
    noise = rng.standard_normal(shape, dtype=np.float32)
    if spread == 0:
        return noise
    kernel = cv2.getGaussianKernel(2 * int(np.ceil(3 * spread)) + 1, spread)
    smooth = cv2.sepFilter2D(noise, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(smooth / np.float32(np.sum(kernel**2)), np.float32)


def cosine_of_incidence(normals: NDArray[np.float32], K: Floats) -> NDArray[np.float32]:
    """Return the (H, W) float32 cosine of the angle between each pixel's ray and its surface normal."""
    height, width = normals.shape[:2]
    x = ((np.arange(width) - K[0, 2]) / K[0, 0]).astype(np.float32)[None, :]
    y = ((np.arange(height) - K[1, 2]) / K[1, 1]).astype(np.float32)[:, None]
    toward = -(normals[..., 0] * x + normals[..., 1] * y + normals[..., 2])
    return np.asarray(toward / np.sqrt(x * x + y * y + 1), np.float32)

"""The time-of-flight sensor: flying pixels, corners rounded by multipath, noise that depends on the amplitude."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.depth_sensor import TrueView, cosine_of_incidence, smooth_noise
from perception.geometry import Floats

_COARSE = 4  # the wide filter of multipath works on an image smaller by this factor


@dataclass(frozen=True, kw_only=True)
class TimeOfFlightModel:
    """Model of a continuous-wave time-of-flight camera, whose depth is registered to the grey image.

    A pixel collects the light of a footprint wider than an image pixel: its depth is the mean over the footprint,
    weighted by the returned light, so depths between foreground and background appear at outlines (flying pixels).
    Light that bounces between the two sides of a concave corner rounds the corner: its bottom appears nearer. The
    noise is Gaussian of standard deviation ``sigma_z sqrt(reference_grey / grey) (z / reference)``: the amplitude falls
    with ``grey / z^2``, and shot noise with its root. Pixels under ``dark`` return too little light.

    The law of shot noise is that of Lange and Seitz, Solid-state time-of-flight range camera, IEEE Journal
    of Quantum Electronics 37 (2001), for a signal that dominates the ambient light. Flying pixels, rounded corners and
    noisier dark materials of a real camera are shown by Tölgyessy et al., Evaluation of the Azure Kinect and its
    comparison to Kinect V1 and Kinect V2, Sensors 21 (2021), which confirms a standard deviation of at most 17 mm. One
    of its pixels (75 degrees over 640 px, so a focal length of 417 px) is 5.8 px of an image of focal length 2400 px.
    The magnitudes of sigma_z and of the rounding are the project's own.
    """

    sigma_z: float = 0.0012  # standard deviation of the depth of a surface of `reference_grey` at `reference` [m]
    reference: float = 0.9  # depth at which sigma_z holds [m]
    reference_grey: float = 150.0  # grey value at which sigma_z holds
    correlation: float = 1.2  # standard deviation of the filter that correlates the errors [px of the image]
    footprint: float = 1.7  # standard deviation of a pixel's footprint [px of the image]: 5.8 px / sqrt(12)
    multipath: float = 0.35  # share by which a concave corner is pulled to its surroundings' mean depth
    multipath_radius: float = 0.006  # standard deviation of the surroundings [m]
    multipath_limit: float = 0.003  # largest shift by multipath [m]
    dark: float = 10.0  # grey value under which nothing is measured
    max_incidence: float = np.deg2rad(80.0)  # angle between ray and normal beyond which nothing returns [rad]

    def __post_init__(self) -> None:
        for name in ("reference", "reference_grey", "multipath_radius"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("sigma_z", "correlation", "footprint", "multipath_limit", "dark"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if not 0 <= self.multipath <= 1:
            raise ValueError(f"multipath must be in [0, 1], got {self.multipath}")
        if not 0 < self.max_incidence <= np.pi / 2:
            raise ValueError(f"max_incidence must be in (0, pi / 2], got {self.max_incidence}")

    def measure(self, view: TrueView, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the measured depth; see `DepthSensor.measure`. One normal number a pixel is drawn."""
        noise = smooth_noise(rng, view.depth.shape, self.correlation)
        light = np.maximum(view.grey.astype(np.float32), np.float32(1)) * (view.depth > 0)
        depth = view.depth - self._rounding(view.depth, view.K)
        if self.footprint > 0:
            depth = _weighted_mean(depth, light, self.footprint)
        sigma = np.float32(self.sigma_z / self.reference) * view.depth
        sigma *= np.sqrt(np.float32(self.reference_grey) / np.maximum(light, np.float32(1)))
        seen = cosine_of_incidence(view.normals, view.K) >= np.cos(self.max_incidence)
        measured = seen & (view.depth > 0) & (view.grey >= self.dark)
        return np.where(measured, np.maximum(depth + sigma * noise, np.float32(0)), np.float32(0)).astype(np.float32)

    def _rounding(self, depth: NDArray[np.float32], K: Floats) -> NDArray[np.float32]:
        """Return how much nearer [m] multipath makes each pixel: a share of its depth below its surroundings' mean."""
        known = depth > 0
        if self.multipath == 0 or not known.any():
            return np.zeros(depth.shape, np.float32)
        spread = self.multipath_radius * K[0, 0] / float(np.median(depth[known]))
        height, width = depth.shape
        small = (max(width // _COARSE, 1), max(height // _COARSE, 1))
        weight = _shrink(known.astype(np.float32), small)
        coarse = np.asarray(_shrink(depth, small) / np.maximum(weight, np.float32(1e-6)), np.float32)
        mean = cv2.resize(_weighted_mean(coarse, weight, spread / _COARSE), (width, height))
        shift = np.clip(self.multipath * (depth - mean), 0, self.multipath_limit)
        return np.where(known, shift, 0).astype(np.float32)


def _shrink(image: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def _weighted_mean(values: NDArray[np.float32], weights: NDArray[np.float32], spread: float) -> NDArray[np.float32]:
    """Return the (H, W) mean of values over a Gaussian neighbourhood of standard deviation ``spread`` [px]."""
    total = cv2.GaussianBlur(values * weights, (0, 0), spread)
    weight = cv2.GaussianBlur(weights, (0, 0), spread)
    return np.asarray(total / np.maximum(weight, np.float32(1e-6)), np.float32)

"""The active-stereo sensor: correlated, quantised disparities, fattened edges and holes."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera import _sensor_kernels
from binpick_env.camera.depth_sensor import TrueView, cosine_of_incidence, smooth_noise

_FAR = np.float32(1e3)  # stands for "no depth" while the nearest neighbour is looked for [m]


@dataclass(frozen=True, kw_only=True)
class StereoModel:
    """Model of two infrared cameras with a pattern projector, whose depth is registered to the grey image.

    The disparity is ``d = focal baseline / z``. Its error is Gaussian, has the standard deviation
    ``subpixel / cos(incidence)`` and is correlated over neighbouring pixels, since their matching windows overlap. The
    disparity is rounded to multiples of ``disparity_step``. Hence ``sigma_z = z^2 subpixel / (focal baseline)``.
    Matching windows that straddle an outline take the near side's depth, so the foreground is fattened. A pixel has no
    depth where the second camera does not see it, and, in patches, where the surface is dark, grazing or mirrors the
    projector into the camera.

    The figures of the preset ``stereo`` are those of the Intel RealSense D415: baseline 55 mm, horizontal field of view
    65 degrees over 1280 px, so a focal length of ``640 / tan(32.5 deg)`` = 1004 px (data sheet of the D400 series);
    disparities in steps of 1/32 px (Grunnet-Jepsen et al., Subpixel linearity improvement for Intel RealSense depth
    cameras D400, 2019). The law for sigma_z, and fattening by the matching window, are those of Keselman et al., Intel
    RealSense stereoscopic depth cameras, CVPR workshops 2017. The subpixel error of 0.08 px, which makes sigma_z 1.2 mm
    at 0.9 m, and the chances of holes are the project's own.
    """

    focal: float = 1004.0  # focal length of the infrared cameras [px]
    baseline: float = 0.055  # position of the second camera along the camera's x axis [m]
    subpixel: float = 0.08  # standard deviation of the disparity of a surface square to the ray [px]
    disparity_step: float = 1 / 32  # smallest difference of two disparities [px]
    correlation: float = 2.5  # standard deviation of the filter that correlates the errors [px of the image]
    fattening: int = 3  # mean width by which the foreground is fattened [px of the image]; single places +-1
    edge_jump: float = 0.005  # smallest depth step at which the foreground is fattened [m]
    max_incidence: float = np.deg2rad(65.0)  # angle between ray and normal from which nothing is matched [rad]
    dark: float = 45.0  # grey value under which matching begins to fail; it always fails at 0
    glint: float = np.deg2rad(5.0)  # angle around the mirror direction in which a surface is overexposed [rad]
    glint_loss: float = 0.4  # share of overexposed pixels that are lost

    def __post_init__(self) -> None:
        for name in ("focal", "disparity_step", "edge_jump"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("subpixel", "correlation", "dark", "glint"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")
        if not 0 < abs(self.baseline) <= 1:
            raise ValueError(f"baseline must be within 1 m and not 0, got {self.baseline}")
        if self.fattening < 0:
            raise ValueError(f"fattening must not be negative, got {self.fattening}")
        if not 0 < self.max_incidence <= np.pi / 2:
            raise ValueError(f"max_incidence must be in (0, pi / 2], got {self.max_incidence}")
        if not 0 <= self.glint_loss <= 1:
            raise ValueError(f"glint_loss must be in [0, 1], got {self.glint_loss}")

    def sigma_z(self, z: float) -> float:
        """Return the standard deviation [m] of the depth of a surface square to the ray at depth ``z`` [m]."""
        return z * z * self.subpixel / (self.focal * abs(self.baseline))

    def measure(self, view: TrueView, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the measured depth; see `DepthSensor.measure`. Two normal numbers a pixel are drawn."""
        disparity_noise = smooth_noise(rng, view.depth.shape, self.correlation)
        chance = smooth_noise(rng, view.depth.shape, self.correlation)
        cosine = cosine_of_incidence(view.normals, view.K)
        near, fattened = self._fatten(view, cosine, chance)
        # Depth to disparity, with noise, rounded; and back.
        sigma = np.float32(self.subpixel) / np.maximum(cosine, np.float32(0.2))
        disparity = np.float32(self.focal * abs(self.baseline)) / np.maximum(near, np.float32(1e-3))
        step = np.float32(self.disparity_step)
        rounded = np.maximum(np.rint((disparity + sigma * disparity_noise) / step), 1) * step
        depth = np.float32(self.focal * abs(self.baseline)) / rounded
        # Patches are lost where the correlated chance, made uniform, is under the share of loss.
        lost = (_uniform(chance) < self._loss(view, cosine)) & ~fattened
        lost |= _sensor_kernels.projector_shadow(view.depth, view.K, self.baseline) & ~fattened
        return np.where((view.depth > 0) & ~lost, depth, np.float32(0))

    def _fatten(
        self, view: TrueView, cosine: NDArray[np.float32], chance: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the depth with the foreground grown, and the pixels that it grew over."""
        depth = view.depth
        if self.fattening == 0:
            return depth, np.zeros(depth.shape, np.bool_)
        known = np.where(depth > 0, depth, _FAR)
        narrow = cv2.erode(known, np.ones((2 * self.fattening - 1,) * 2, np.uint8), borderValue=float(_FAR))
        wide = cv2.erode(known, np.ones((2 * self.fattening + 3,) * 2, np.uint8), borderValue=float(_FAR))
        nearest = np.where(chance > 0, wide, narrow)
        # What the surface's own slope explains over the window is no step.
        steepness = 1 / np.maximum(cosine, np.float32(0.1))
        slope = np.float32((self.fattening + 1) * np.sqrt(2) / view.K[0, 0]) * depth * steepness
        grown = (depth > 0) & (known - nearest > np.float32(self.edge_jump) + slope)
        return np.where(grown, nearest, depth), grown

    def _loss(self, view: TrueView, cosine: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the (H, W) share of pixels that are lost: dark, overexposed and grazing surfaces."""
        if self.dark > 0:
            loss = 1 - np.minimum(view.grey.astype(np.float32) / np.float32(self.dark), np.float32(1))
        else:
            loss = np.zeros(view.depth.shape, np.float32)
        loss = np.where(cosine > np.cos(self.glint), np.maximum(loss, np.float32(self.glint_loss)), loss)
        return np.where(cosine < np.cos(self.max_incidence), np.float32(1), loss).astype(np.float32)


def _uniform(normal: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return standard normal numbers as uniform ones in (0, 1): the logistic approximation, within 0.01."""
    return np.asarray(1 / (1 + np.exp(np.float32(-1.702) * normal)), np.float32)

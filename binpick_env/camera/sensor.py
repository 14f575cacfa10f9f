"""The structured-light sensor: noise and losses of the measured depth; the presets of all sensors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from binpick_env.camera import _sensor_kernels
from binpick_env.camera.depth_sensor import DepthSensor, TrueView
from binpick_env.camera.stereo import StereoModel
from binpick_env.camera.time_of_flight import TimeOfFlightModel
from binpick_env.config import SensorPreset
from perception.geometry import Floats, require_shape

_ROWS = 64  # rows that are measured at once: their random numbers stay in the processor's cache


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """Model of a camera with a projector beside it.

    A pixel has no depth where the projector does not reach, where the surface is seen at more than ``max_incidence``,
    and, with probability ``edge_loss``, beside a depth discontinuity. Elsewhere white Gaussian noise is added, of
    standard deviation ``sigma_z (z / reference)^2 / cos(incidence)``. The grey image is not touched.
    """

    sigma_z: float = 0.0  # standard deviation of the depth of a surface square to the ray, at `reference` [m]
    reference: float = 0.9  # depth at which sigma_z holds [m]
    edge_loss: float = 0.0  # share of the pixels beside depth discontinuities that are lost
    edge_jump: float = 0.003  # smallest depth step, beyond what the surface's slope explains, that is an edge [m]
    max_incidence: float = np.pi / 2  # angle between ray and surface normal beyond which nothing returns [rad]
    baseline: float = 0.0  # position of the projector along the camera's x axis [m]; 0 casts no shadow

    def __post_init__(self) -> None:
        if not (0 <= self.sigma_z < np.inf and self.reference > 0 and self.edge_jump > 0):
            raise ValueError(
                "sigma_z must not be negative, reference and edge_jump must be positive, "
                f"got {self.sigma_z}, {self.reference}, {self.edge_jump}"
            )
        if not 0 <= self.edge_loss <= 1:
            raise ValueError(f"edge_loss must be in [0, 1], got {self.edge_loss}")
        if not 0 < self.max_incidence <= np.pi / 2:
            raise ValueError(f"max_incidence must be in (0, pi / 2], got {self.max_incidence}")
        if not abs(self.baseline) <= 1:
            raise ValueError(f"baseline must be within 1 m, got {self.baseline}")

    @property
    def is_perfect(self) -> bool:
        """Whether every true depth is measured exactly."""
        return self.sigma_z == self.edge_loss == self.baseline == 0 and self.max_incidence == np.pi / 2

    def measure(self, view: TrueView, rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the measured depth; see `DepthSensor.measure`. The grey image plays no part."""
        return self.apply(view.depth, view.normals, view.K, rng)

    def apply(
        self,
        depth_true: NDArray[np.float32],
        normals: NDArray[np.float32],
        K: Floats,
        rng: np.random.Generator,
    ) -> NDArray[np.float32]:
        """Return the measured (H, W) float32 depth [m], 0 where there is no measurement.

        Args:
            depth_true: (H, W) float32 noise-free depth [m], 0 where there is nothing.
            normals: (H, W, 3) float32 unit surface normals in the camera frame, towards the eye.
            K: (3, 3) pinhole matrix [px].
            rng: Source of all random numbers. A perfect sensor draws none, any other draws two numbers a pixel.
        """
        require_shape("depth_true", depth_true, (None, None))
        require_shape("normals", normals, (*depth_true.shape, 3))
        require_shape("K", K, (3, 3))
        if self.is_perfect:
            return depth_true.copy()
        noise = rng.standard_normal(depth_true.shape, dtype=np.float32)
        measured = np.empty(depth_true.shape, np.float32)
        chance = np.empty((_ROWS, depth_true.shape[1]), np.float32)
        for first in range(0, len(depth_true), _ROWS):
            rows = chance[: len(depth_true) - first]
            rng.random(dtype=np.float32, out=rows)
            _sensor_kernels.measure_rows(
                depth_true,
                normals,
                K,
                noise,
                rows,
                first,
                self.sigma_z,
                self.reference,
                self.edge_loss,
                self.edge_jump,
                float(np.cos(self.max_incidence)),
                self.baseline,
                measured,
            )
        return measured


# The figures of the presets are the project's definition of a sensor; official results use "good".
PRESETS: dict[SensorPreset, DepthSensor] = {
    "none": SensorModel(),
    "good": SensorModel(sigma_z=0.0003, edge_loss=0.02, max_incidence=np.deg2rad(75.0), baseline=0.15),
    "harsh": SensorModel(sigma_z=0.001, edge_loss=0.10, max_incidence=np.deg2rad(65.0), baseline=0.15),
    "stereo": StereoModel(),
    "tof": TimeOfFlightModel(),
}


def sensor_model(sensor: SensorPreset | DepthSensor) -> DepthSensor:
    """Return the model of a preset by its name; a model is returned as it is.

    Raises:
        ValueError: There is no such preset.
    """
    if not isinstance(sensor, str) and isinstance(sensor, DepthSensor):
        return sensor
    if sensor not in PRESETS:
        raise ValueError(f"sensor must be one of {', '.join(PRESETS)} or a DepthSensor, got {sensor!r}")
    return PRESETS[sensor]

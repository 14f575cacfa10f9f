"""The grey image: Lambertian bodies under one lamp at the camera, without texture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from binpick_env.camera import _image_kernels, _occlusion_kernels
from perception.geometry import Floats

FACET = 0.0003  # height up to which nothing is occluded [m]: a facet over its smooth surface, and rounding
STEP = 0.0015  # further height from which occlusion is complete [m]


@dataclass(frozen=True, kw_only=True)
class Light:
    """Lighting of the grey image.

    ``grey = 255 albedo (ambient + diffuse max(0, n l)) (1 - occlusion occluded)
    (1 + falloff ((reference / z)^2 - 1))``, where ``occluded`` in [0, 1] is the ambient occlusion by what stands
    close by, above the pixel's tangent plane. It keeps the outline of a plate on a parallel plate visible.
    """

    to_light: tuple[float, float, float] = (0.35, -0.45, -0.82)  # direction to the lamp, camera frame; any length
    ambient: float = 0.25  # intensity of the light from everywhere
    diffuse: float = 0.75  # intensity of the light from the lamp
    part_albedo: float = 0.8  # albedo of parts
    container_albedo: float = 0.45  # albedo of everything else
    falloff: float = 0.5  # decrease of intensity with depth: 0 for none, 1 for the inverse square
    reference: float = 0.9  # depth at which the falloff leaves the intensity as it is [m]
    occlusion: float = 0.8  # share of light that a point loses which is occluded on all sides, 0 to 1
    radius: float = 0.005  # distance over which the occlusion by a neighbour fades [m]
    background: int = 0  # grey value outside the camera's region and where there is nothing

    def __post_init__(self) -> None:
        if not 0 < float(np.linalg.norm(self.to_light)) < np.inf:
            raise ValueError(f"to_light must be a finite vector that is not zero, got {self.to_light}")
        for name in ("ambient", "diffuse", "part_albedo", "container_albedo", "falloff", "occlusion"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be in [0, 1], got {getattr(self, name)}")
        if not (self.reference > 0 and self.radius > 0):
            raise ValueError(f"reference and radius must be positive, got {self.reference} and {self.radius}")
        if not 0 <= self.background <= 255:
            raise ValueError(f"background must be in 0 to 255, got {self.background}")

    def shade(
        self, depth: NDArray[np.float32], normals: NDArray[np.float32], instance_ids: NDArray[np.int64], K: Floats
    ) -> NDArray[np.uint8]:
        """Return the (H, W) grey image.

        Args:
            depth: (H, W) noise-free depth [m], 0 for nothing.
            normals: (H, W, 3) unit normals, camera frame.
            instance_ids: (H, W) part seen by each pixel, -1 for everything else.
            K: (3, 3) pinhole matrix [px].
        """
        return self.shade_albedo(depth, normals, self.albedo(instance_ids >= 0), K)

    def albedo(self, is_part: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Return the (H, W) float32 albedo of parts and of everything else."""
        return np.where(is_part, np.float32(self.part_albedo), np.float32(self.container_albedo))

    def shade_albedo(
        self, depth: NDArray[np.float32], normals: NDArray[np.float32], albedo: NDArray[np.float32], K: Floats
    ) -> NDArray[np.uint8]:
        """Return the (H, W) grey image of surfaces with (H, W) float32 albedos in [0, 1]; see `shade`."""
        to_light = np.array(self.to_light) / np.linalg.norm(self.to_light)
        if self.occlusion > 0:
            occluded = _occlusion_kernels.ambient_occlusion(depth, normals, K, self.radius, FACET, STEP)
        else:
            occluded = np.zeros_like(depth)
        grey: NDArray[np.uint8] = _image_kernels.shade(
            depth,
            normals,
            albedo,
            occluded,
            to_light,
            self.ambient,
            self.diffuse,
            self.falloff,
            self.reference,
            self.occlusion,
            self.background,
        )
        return grey

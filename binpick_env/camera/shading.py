"""The grey image: Lambertian bodies under one lamp at the camera, without texture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from binpick_env.camera import _image_kernels
from perception.geometry import Floats

FACET = 0.0003  # a flat facet's height over its smooth surface, and rounding: darkens nothing [m]
STEP = 0.0015  # height over a neighbour at which it is fully darkened [m]


@dataclass(frozen=True, kw_only=True)
class Light:
    """How depth and normals become grey.

    ``grey = 255 albedo (ambient + diffuse max(0, n l)) (1 - occlusion hidden) (1 + falloff ((reference / z)^2 - 1))``,
    where ``hidden`` in [0, 1] is the share of eight directions in which something close by stands above the pixel's own
    tangent plane: it keeps the outline of a plate on a parallel plate visible, as it is in a real bin.
    """

    to_light: tuple[float, float, float] = (0.35, -0.45, -0.82)  # from the scene to the lamp, camera frame; any length
    ambient: float = 0.25  # light from everywhere
    diffuse: float = 0.75  # light from the lamp
    part_albedo: float = 0.8  # of parts
    container_albedo: float = 0.45  # of everything else
    falloff: float = 0.5  # 0 none, 1 the inverse square of depth
    reference: float = 0.9  # depth at which the falloff is 1 [m]
    occlusion: float = 0.8  # 0 to 1, how much darker a point is that is hidden on all sides
    radius: float = 0.005  # over which a neighbour's darkness fades [m]
    background: int = 0  # grey outside the camera's region and where there is nothing

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
            normals: (H, W, 3) unit, camera frame.
            instance_ids: (H, W), -1 for everything that is no part.
            K: (3, 3) pinhole matrix [px].
        """
        to_light = np.array(self.to_light) / np.linalg.norm(self.to_light)
        albedo = np.where(instance_ids >= 0, np.float32(self.part_albedo), np.float32(self.container_albedo))
        if self.occlusion > 0:
            hidden = _image_kernels.ambient_occlusion(depth, normals, K, self.radius, FACET, STEP)
        else:
            hidden = np.zeros_like(depth)
        grey: NDArray[np.uint8] = _image_kernels.shade(
            depth,
            normals,
            albedo,
            hidden,
            to_light,
            self.ambient,
            self.diffuse,
            self.falloff,
            self.reference,
            self.occlusion,
            self.background,
        )
        return grey

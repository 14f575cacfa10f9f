"""Small images with steps, slopes, holes and odd normals, for kernels that are compared with their twins."""

import numpy as np

from perception.geometry import Floats


def random_image(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, Floats]:
    """Return (H, W) float32 depth, (H, W, 3) float32 unit normals towards the eye, and the pinhole matrix."""
    height, width = (int(size) for size in rng.integers(1, 40, 2))
    v, u = np.mgrid[:height, :width]
    depth = np.full((height, width), 0.9)
    for _ in range(rng.integers(0, 6)):  # plates, flat or tilted
        left, top, right, bottom = rng.integers(-5, 45, 4)
        tilt = rng.normal(size=2) * rng.choice([0.0, 2e-4, 2e-3])
        plate = rng.uniform(0.85, 0.9) + tilt[0] * (u - left) + tilt[1] * (v - top)
        inside = (u >= left) & (u < right) & (v >= top) & (v < bottom)
        depth = np.where(inside, np.minimum(depth, plate), depth)
    depth += rng.choice([0.0, 2e-4]) * rng.normal(size=depth.shape)
    depth[rng.random(depth.shape) < rng.choice([0.0, 0.05])] = 0.0
    normals = rng.normal(size=(height, width, 3)) * rng.choice([0.0, 0.2, 1.0])
    normals[..., 2] = -1 - np.abs(normals[..., 2])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    normals[depth == 0] = 0
    K = np.array([[600.0, 0, (width - 1) / 2], [0, 620.0, (height - 1) / 2], [0, 0, 1]])
    return depth.astype(np.float32), normals.astype(np.float32), K

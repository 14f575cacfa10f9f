"""The grey image under an appearance: highlights, worn edges, uneven light, blur and image noise."""

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.appearance import Appearance
from binpick_env.camera.shading import Light
from binpick_env.camera.surface import convexity
from binpick_env.camera.view import View

Singles = NDArray[np.float32]


def photograph(
    grey: NDArray[np.uint8],
    normals: NDArray[np.float32],
    is_part: NDArray[np.bool_],
    view: View,
    looks: tuple[Appearance, Light],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return the grey image with highlights, wear, uneven light, blur and noise.

    Args:
        grey: (H, W) uint8 Lambertian image. Only the view's region is changed.
        normals: (H, W, 3) float32 unit normals, camera frame.
        is_part: (H, W) bool mask of the parts' pixels.
        view: Region and pinhole matrix of the image.
        looks: Appearance, and the light of the Lambertian image.
        rng: Source of one normal number a pixel if there is image noise; it is not used otherwise.
    """
    appearance, light = looks
    u0, v0, u1, v1 = view.region
    inside = np.s_[v0:v1, u0:u1]
    image, normals, is_part = grey[inside].astype(np.float32), normals[inside], is_part[inside]
    # Image coordinates from the middle, in units of half the image's width; and in units of the focal length.
    half = np.float32(view.width / 2)
    x = (np.arange(u0, u1) - view.K[0, 2]).astype(np.float32)[None, :] / half
    y = (np.arange(v0, v1) - view.K[1, 2]).astype(np.float32)[:, None] / half
    rays = (x * half / np.float32(view.K[0, 0]), y * half / np.float32(view.K[1, 1]))
    if appearance.wear > 0:
        image += np.float32(255 * appearance.wear) * convexity(normals) * is_part
    if appearance.specular > 0:
        image += np.float32(255 * appearance.specular) * _highlights(normals, rays, appearance, light) * is_part
    turn = appearance.gradient_direction
    image *= 1 + np.float32(appearance.gradient) * (x * np.float32(np.cos(turn)) + y * np.float32(np.sin(turn)))
    image *= np.maximum(1 - np.float32(appearance.vignetting) * (x * x + y * y), 0)
    if appearance.blur > 0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), appearance.blur), np.float32)
    if appearance.noise > 0:
        image += np.float32(appearance.noise) * rng.standard_normal(image.shape, dtype=np.float32)
    seen = grey.copy()
    seen[inside] = np.clip(np.rint(image), 0, 255)
    return seen


def _highlights(
    normals: Singles, rays: tuple[Singles, Singles], appearance: Appearance, light: Light
) -> NDArray[np.float32]:
    """Return Phong's highlights, (H, W) float32: a power of the cosine between mirrored light and ray."""
    x, y = rays
    to_light = (np.array(light.to_light) / np.linalg.norm(light.to_light)).astype(np.float32)
    n_l = normals @ to_light
    n_e = -(normals[..., 0] * x + normals[..., 1] * y + normals[..., 2])
    l_e = -(to_light[0] * x + to_light[1] * y + to_light[2])
    cosine = (2 * n_l * n_e - l_e) / np.sqrt(x * x + y * y + 1)
    mirrored = np.where((n_l > 0) & (cosine > 0), cosine, 0)
    return np.asarray(mirrored ** np.float32(appearance.shininess), np.float32)

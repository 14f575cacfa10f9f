"""The parts' surfaces under an appearance: deviation from CAD, printed labels and worn edges, in part coordinates."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.camera.appearance import Appearance
from binpick_env.camera.view import Hits, View
from perception.geometry import Floats

_WAVES = 4  # number of plane waves that make up a deviation
_MIN_COSINE = 0.2  # cosine of incidence at which the depth's change by a deviation stops growing
_WEAR_CURVATURE = 0.25  # change of the normal per pixel at which a convex edge is fully worn


@dataclass(frozen=True, eq=False, kw_only=True)
class PartPixels:
    """The pixels of one geom of a part.

    Attributes:
        part: Number of the part.
        geom: Geom of the model.
        v: (N,) rows.
        u: (N,) columns.
    """

    part: int
    geom: int
    v: NDArray[np.int64]
    u: NDArray[np.int64]


def part_pixels(geom_at: NDArray[np.int32], instances: NDArray[np.int64]) -> list[PartPixels]:
    """Return the pixels of every geom that belongs to a part and is seen.

    Args:
        geom_at: (H, W) int32 geom seen by each pixel, -1 for nothing.
        instances: (ngeom + 1,) part of each geom, -1 for none; the last entry stands for nothing.
    """
    flat = geom_at.reshape(-1)
    mine = np.nonzero(instances[flat] >= 0)[0]
    mine = mine[np.argsort(flat[mine], kind="stable")]
    geoms, first = np.unique(flat[mine], return_index=True)
    groups = np.split(mine, first[1:]) if len(geoms) else []
    width = geom_at.shape[1]
    return [
        PartPixels(part=int(instances[geom]), geom=int(geom), v=pixels // width, u=pixels % width)
        for geom, pixels in zip(geoms, groups, strict=True)
    ]


def deviate(hits: Hits, view: View, pixels: list[PartPixels], appearance: Appearance) -> Hits:
    """Return the hits with the parts' surfaces moved along their normals, and the normals turned accordingly.

    The deviation of a part is the mean of four plane waves in its geom's coordinates, so it never exceeds
    ``appearance.deviation``. Outlines stay where they are.
    """
    depth, normals = hits.depth.copy(), hits.normals.copy()
    for each in pixels:
        rng = np.random.default_rng(np.random.SeedSequence([appearance.seed, each.part, 0]))
        waves = _random_directions(rng) * 2 * np.pi / (appearance.wavelength * rng.uniform(1.0, 3.0, (_WAVES, 1)))
        phases = rng.uniform(0.0, 2 * np.pi, _WAVES)
        R_cam_geom = view.rotations[each.geom]
        rays = _rays(each, view.K)
        points_cam = rays * hits.depth[each.v, each.u][:, None]
        angles = (points_cam - view.positions[each.geom]) @ R_cam_geom @ waves.T + phases
        height = appearance.deviation * np.cos(angles).mean(axis=1)
        slope_cam = (-appearance.deviation / _WAVES) * np.sin(angles) @ waves @ R_cam_geom.T
        # A point moved by its normal: the depth along its ray changes by height / (n ray), with n towards the eye.
        n = hits.normals[each.v, each.u].astype(np.float64)
        along = np.minimum(np.sum(n * rays, axis=1), -_MIN_COSINE)
        depth[each.v, each.u] += height / along
        turned = n - (slope_cam - np.sum(slope_cam * n, axis=1, keepdims=True) * n)
        normals[each.v, each.u] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return Hits(depth=depth, geom_at=hits.geom_at, normals=normals)


def label_albedo(
    albedo: NDArray[np.float32],
    hits: Hits,
    view: View,
    pixels: list[PartPixels],
    boxes: Floats,
    appearance: Appearance,
) -> NDArray[np.float32]:
    """Return the albedo with printed labels: a bright or dark rectangle with bars like lines of text on one side.

    Args:
        albedo: (H, W) float32 albedo of every pixel.
        hits: First surface behind every pixel.
        view: Poses of the geoms.
        pixels: Pixels of the parts.
        boxes: (ngeom, 6) centre and half sizes of each geom's box in its coordinates [m].
        appearance: Share of parts that bear a label, and the seed.
    """
    printed = albedo.copy()
    for each in pixels:
        rng = np.random.default_rng(np.random.SeedSequence([appearance.seed, each.part, 1]))
        if rng.random() >= appearance.labelled:
            continue
        centre, half = boxes[each.geom, :3], boxes[each.geom, 3:]
        axis, side = int(rng.integers(3)), 1.0 if rng.random() < 0.5 else -1.0
        a, b = [k for k in range(3) if k != axis]
        if half[b] > half[a]:
            a, b = b, a  # the lines run along the longer side
        size = half[[a, b]] * rng.uniform([0.3, 0.3], [0.7, 0.8])
        middle = centre[[a, b]] + rng.uniform(-1.0, 1.0, 2) * (half[[a, b]] - size)
        ground, ink = (0.95, 0.1) if rng.random() < 0.5 else (0.12, 0.9)
        pitch, words = rng.uniform(0.0025, 0.005), rng.random((16, 24)) < 0.7
        R_cam_geom = view.rotations[each.geom]
        points = (_rays(each, view.K) * hits.depth[each.v, each.u][:, None] - view.positions[each.geom]) @ R_cam_geom
        facing = side * (hits.normals[each.v, each.u] @ R_cam_geom[:, axis]) > 0.7
        x, y = points[:, a] - middle[0] + size[0], points[:, b] - middle[1] + size[1]
        on = facing & (x >= 0) & (x < 2 * size[0]) & (y >= 0) & (y < 2 * size[1])
        line, word = (y[on] // pitch).astype(np.int64), (x[on] // (0.8 * pitch)).astype(np.int64)
        inked = (y[on] % pitch > 0.45 * pitch) & words[line % 16, word % 24]
        printed[each.v[on], each.u[on]] = np.where(inked, ink, ground)
    return printed


def convexity(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return how sharply convex the surface is at every pixel, (H, W) float32 in [0, 1].

    On a convex edge normals turn away from each other: their divergence in the image is positive.
    """
    across = cv2.Sobel(normals[..., 0], cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    down = cv2.Sobel(normals[..., 1], cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    return np.asarray(np.clip((across + down) / np.float32(_WEAR_CURVATURE), 0, 1), np.float32)


def _random_directions(rng: np.random.Generator) -> Floats:
    directions = rng.normal(size=(_WAVES, 3))
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


def _rays(pixels: PartPixels, K: Floats) -> Floats:
    """Return the (N, 3) rays through pixels, of depth 1."""
    x, y = (pixels.u - K[0, 2]) / K[0, 0], (pixels.v - K[1, 2]) / K[1, 1]
    return np.stack([x, y, np.ones_like(x)], axis=1)

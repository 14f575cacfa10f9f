"""What a load has left behind: the surface that is gone from the bin beside the part that was picked."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from binpick_env.env import BinPickEnv
from perception.frame import Frame, bin_region
from perception.geometry import Floats
from perception.part import PartModel
from perception.thickness import part_thickness
from policies.grasping.heightmap import HeightMap
from policies.grasping.observed_scene import ObservedScene

_STEP = 0.003  # change of height from which a cell shows another surface [m]: above the noise
_FILLED = 0.002  # the same where the picked part was: something that is nearly as high lies there now [m]
_ON_TOP = 0.004  # height over the picked part's surface from which a cell shows what lies on it [m]
_FAR_ABOVE = 0.06  # height above the rim that no heaped pile reaches [m]
_HIDDEN = 1e-4  # area in that height from which the bin counts as hidden [m^2]
_CHANGED = 2e-4  # connected area of other depth from which something moved [m^2]; noise changes a quarter of that
_THINNEST = 0.004  # thickness of a part from which its place shows another surface without it [m]
_MARGIN = 0.006  # width around the picked part's outline that is left out [m]: pose errors, and edges
_CROSS = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))


def image_of(env: BinPickEnv, rng: np.random.Generator) -> Frame:
    """Take an image of the bin, with noise drawn from ``rng``; the environment's last frame and candidates stay."""
    env.simulation.refresh()
    return env.camera.capture(env.simulation.data, rng, env.sensor, env.light).frame


def gone_beside(
    scene: ObservedScene, image: Frame, surface_part: Floats, T_world_part: Floats, wall: float
) -> float | None:
    """Return the area beside or on a picked part that is lower than before, less the area that is higher [m^2].

    None if something far above the bin hides a part of it, which can only be the arm with its load.

    A neighbour that came along leaves its area lower. One that only slid lowers the surface in one place and raises it
    in another, which may be where the picked part was. What came along from under that part does not show.

    Args:
        scene: The bin before the attempt.
        image: Image of the bin with the arm and its load out of view, by the camera of the scene's frame, which has
            not moved.
        surface_part: (S, 3) dense points on the part's surface, part frame [m].
        T_world_part: (4, 4) pose of the picked part before the attempt.
        wall: Thickness of the bin's walls [m].

    Raises:
        ValueError: The image is of another camera.
    """
    if image.depth.shape != scene.frame.depth.shape or not np.array_equal(image.K, scene.frame.K):
        sizes = f"{image.depth.shape} and {scene.frame.depth.shape}"
        raise ValueError(f"the image must be by the camera of the scene's frame, got images of {sizes}")
    before = scene.heights
    unmoved = replace(image, T_world_cam=scene.frame.T_world_cam)
    heights = HeightMap.from_frame(unmoved, scene.workspace, cell=before.cell, wall=wall)
    if _hides_bin(heights):
        return None
    after = heights.measured
    surface = before.rasterise(surface_part, T_world_part)
    outline = np.isfinite(surface)
    seen = np.isfinite(before.measured) & np.isfinite(after)
    rise = _difference(after, before.measured, seen)
    above = _difference(before.measured, surface, seen & outline)
    own = seen & outline & (np.abs(above) <= _ON_TOP)  # cells that showed the part itself
    others = seen & (_beside(outline, before) | (outline & (above > _ON_TOP)))
    higher = (others & (rise > _STEP)) | (own & (rise > -_FILLED))
    return before.cell**2 * (_area(others & (rise < -_STEP)) - _area(higher))


def bin_changed(env: BinPickEnv, image: Frame, cell: float) -> bool:
    """Return whether the environment's last frame shows the bin otherwise than a later image does.

    It does so where the arm or its load hides a part of the bin in the frame, too.

    Args:
        env: The unwrapped cell.
        image: Image by the same camera.
        cell: Edge length of a cell of the frame's height map [m].
    """
    frame, workspace = env.frame, env.workspace
    if _hides_bin(HeightMap.from_frame(frame, workspace, cell=cell, wall=env.config.bin.wall)):
        return True
    size = frame.depth.shape[1], frame.depth.shape[0]
    u0, v0, u1, v1 = bin_region(workspace, frame.K, frame.T_world_cam, size, margin=0.0, headroom=0.0)
    before, after = (each.depth[v0:v1, u0:u1].astype(np.float64) for each in (frame, image))
    moved = np.abs(_difference(before, after, (before > 0) & (after > 0))) > _STEP
    pixels = cv2.connectedComponentsWithStats(cv2.morphologyEx(moved.astype(np.uint8), cv2.MORPH_OPEN, _CROSS))[2]
    pixel = float(np.median(before)) ** 2 / (frame.K[0, 0] * frame.K[1, 1])  # area that a pixel shows [m^2]
    return bool(pixels[1:, cv2.CC_STAT_AREA].max(initial=0) * pixel > _CHANGED)


def shows_motion(part: PartModel) -> bool:
    """Return whether :func:`bin_changed` sees that a part has gone; thinner and smaller ones change too little."""
    return part_thickness(part) >= _THINNEST and mean_silhouette(part) >= 2 * _CHANGED


def mean_silhouette(part: PartModel) -> float:
    """Return the area of the silhouette of a part's convex hull [m^2], as a mean over all directions.

    It is a quarter of the hull's surface (Cauchy).
    """
    return float(part.mesh.convex_hull.area) / 4


def _hides_bin(heights: HeightMap) -> bool:
    """Return whether something is far above the bin, which can only be the arm with its load."""
    return bool(_area(heights.measured > heights.rim + _FAR_ABOVE) * heights.cell**2 > _HIDDEN)


def _difference(first: Floats, second: Floats, known: NDArray[np.bool_]) -> Floats:
    """Return first - second where both are known, 0 elsewhere."""
    return np.where(known, first, 0.0) - np.where(known, second, 0.0)


def _beside(outline: NDArray[np.bool_], heights: HeightMap) -> NDArray[np.bool_]:
    """Return the (X, Y) mask of the cells within the bin's walls that lie farther from an outline than the margin."""
    cells = int(np.ceil(_MARGIN / heights.cell))
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * cells + 1, 2 * cells + 1))
    beside = np.zeros(outline.shape, dtype=np.bool_)
    beside[heights.inner] = True
    beside &= cv2.dilate(outline.astype(np.uint8), around) == 0
    return beside


def _area(cells: NDArray[np.bool_]) -> int:
    """Return the number of cells of a mask, without lines one cell wide: edges that noise moved."""
    return int(cv2.morphologyEx(cells.astype(np.uint8), cv2.MORPH_OPEN, _CROSS).sum())

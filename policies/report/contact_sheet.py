"""A contact sheet of the generated parts: one part of each family, seen from above at an angle, with its name."""

from collections.abc import Sequence

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.ray.ray_pyembree import RayMeshIntersector

from binpick_env.parts.families import HELD_OUT_FAMILIES, TRAINING_FAMILIES
from binpick_env.parts.part import generate_part
from perception.geometry import Floats, rotation_about

_TILE, _CAPTION, _COLUMNS = 150, 20, 9  # side of a picture [px], height of the line below [px], pictures in a row
_SUPERSAMPLING = 2
_MARGIN = 0.9  # share of a picture's side that the part fills
_TO_LIGHT = np.array([-0.4, 0.5, 0.77])  # direction to the light, in axes of the view: right, up, towards the eye
_R_VIEW_PART = rotation_about((1, 0, 0), np.deg2rad(-58)) @ rotation_about((0, 0, 1), np.deg2rad(38))
_UPSIDE_DOWN = ("corner_bracket", "hollow_cap", "piston", "star_knob")  # families that show nothing from above
_INK = {"trained": (0, 0, 0), "held out": (170, 0, 0)}  # RGB


def family_sheet(index: int) -> NDArray[np.uint8]:
    """Return an (H, W, 3) uint8 RGB picture of the ``index``-th part of every family; held-out ones have red names."""
    tiles = [_tile(family, index, "trained") for family in TRAINING_FAMILIES]
    tiles += [_tile(family, index, "held out") for family in HELD_OUT_FAMILIES]
    return _grid(tiles)


def portrait(mesh: trimesh.Trimesh, R_view_part: Floats, side: int) -> NDArray[np.uint8]:
    """Return a (side, side) uint8 grey picture of a mesh on white, in parallel projection.

    Args:
        mesh: Watertight mesh, part frame [m].
        R_view_part: (3, 3) rotation from part axes to axes of the view: right, up, towards the eye.
        side: Side of the picture [px].
    """
    turned = trimesh.Trimesh(mesh.vertices @ R_view_part.T, mesh.faces, process=False)
    turned.apply_translation(-turned.bounds.mean(axis=0))
    size = float(turned.extents[:2].max())
    turned.vertices /= size  # rays of embree are single precision, with offsets of their own
    count = side * _SUPERSAMPLING
    steps = ((np.arange(count) + 0.5) / count - 0.5) / _MARGIN
    x, y = np.meshgrid(steps, -steps)
    eyes = np.stack([x, y, np.full_like(x, 10.0)], axis=-1).reshape(-1, 3)
    hit = RayMeshIntersector(turned).intersects_first(eyes, np.tile([0.0, 0.0, -1.0], (len(eyes), 1)))
    grey = 66.0 + 169.0 * np.clip(turned.face_normals @ _TO_LIGHT, 0.0, 1.0)
    pixels = np.where(hit >= 0, grey[hit], 255.0).reshape(count, count).astype(np.uint8)
    return np.asarray(cv2.resize(pixels, (side, side), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _tile(family: str, index: int, use: str) -> NDArray[np.uint8]:
    over = rotation_about((1, 0, 0), np.pi) if family in _UPSIDE_DOWN else np.eye(3)
    picture = portrait(generate_part(family, index).model.mesh, _R_VIEW_PART @ over, _TILE)
    tile = np.full((_TILE + _CAPTION, _TILE, 3), 255, dtype=np.uint8)
    tile[:_TILE] = picture[:, :, None]
    cv2.putText(tile, family, (8, _TILE + 12), cv2.FONT_HERSHEY_SIMPLEX, 0.38, _INK[use], 1, cv2.LINE_AA)
    return tile


def _grid(tiles: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    blank = np.full_like(tiles[0], 255)
    filled = [*tiles, *[blank] * (-len(tiles) % _COLUMNS)]
    rows = [np.hstack(filled[start : start + _COLUMNS]) for start in range(0, len(filled), _COLUMNS)]
    return np.vstack(rows)

"""Solids whose edges are known, and comparisons of edge points."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from perception.geometry import Floats
from perception.part import PartModel
from perception.pose.model.edge_models import EdgeModel

UP, DOWN, FRONT, BACK, CORNER = 0, 1, 2, 3, 6
VIEWS_OF_X = {UP: (0, 0, 1), DOWN: (0, 0, -1), FRONT: (1, 0, 0), BACK: (-1, 0, 0), CORNER: (1, 1, 1)}


def a_part(mesh: trimesh.Trimesh) -> PartModel:
    return PartModel.from_mesh("test", mesh)


def prism(outline: list[tuple[float, float]], low: float, high: float) -> trimesh.Trimesh:
    """A convex outline, anticlockwise, extruded along z."""
    return trimesh.convex.convex_hull(np.array([(x, y, z) for x, y in outline for z in (low, high)]))


def cube() -> PartModel:
    return a_part(trimesh.creation.box(extents=(0.04, 0.04, 0.04)))


def bracket() -> PartModel:
    """An L: a floor of 60 x 30 x 6 mm and a wall of 6 x 30 x 40 mm at its -x end."""
    floor = trimesh.creation.box(bounds=[(0, 0, 0), (0.06, 0.03, 0.006)])
    wall = trimesh.creation.box(bounds=[(0, 0, 0), (0.006, 0.03, 0.04)])
    return a_part(trimesh.boolean.union([floor, wall], engine="manifold"))


def stepped(height: float) -> PartModel:
    """A block of 60 x 60 x 20 mm with a smaller one of ``height`` on it."""
    block = trimesh.creation.box(bounds=[(-0.03, -0.03, 0), (0.03, 0.03, 0.02)])
    step = trimesh.creation.box(bounds=[(-0.01, -0.01, 0.01), (0.01, 0.01, 0.02 + height)])
    return a_part(trimesh.boolean.union([block, step], engine="manifold"))


def boss_on_plate() -> PartModel:
    plate = trimesh.creation.box(bounds=[(-0.04, -0.03, 0), (0.04, 0.03, 0.001)])
    boss = trimesh.creation.box(bounds=[(-0.01, -0.008, 0), (0.01, 0.008, 0.011)])
    return a_part(trimesh.boolean.union([plate, boss], engine="manifold"))


def edges_seen(model: EdgeModel, view: int) -> int:
    """How many of a box's edges (lines of the bounding box) have points in a view."""
    points, tangents = model.points[model.visible_in(view)], model.tangents[model.visible_in(view)]
    low, high = model.centre - 0.02, model.centre + 0.02
    along = np.argmax(np.abs(tangents), axis=1)
    lines = {
        (int(axis), *(np.delete(point, axis) > np.delete((low + high) / 2, axis)).tolist())
        for axis, point in zip(along, points, strict=True)
    }
    return len(lines)


def gaps(points_a: Floats, points_b: Floats) -> float:
    """The largest distance from a point of one set to the other set, both ways."""
    return float(max(cKDTree(points_b).query(points_a)[0].max(), cKDTree(points_a).query(points_b)[0].max()))

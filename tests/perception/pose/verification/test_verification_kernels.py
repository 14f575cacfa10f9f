"""What occludes a point, what explains one, and what is near a surface: by hand, and against plain twins."""

import numpy as np
import pytest

from perception.geometry import Floats, make_transform, transform_points
from perception.pose.model.surface_models import surface_model
from perception.pose.verification import _verification_kernels as kernels
from perception.pose.verification._matching_kernels import explained_points, match_edges
from perception.pose.verification.boundary_index import index_boundary
from tests.perception.pose import observed_part as at
from tests.perception.pose.observed_part import K
from tests.reference import refine_twin as twin

ELL = at.ell()
POINTS, TANGENTS = at.wires(ELL, 0.004)
SURFACE = surface_model(ELL, 0.08)
HERE = make_transform()
MIDDLE = (119.5, 89.5)  # of the image [px]


def point_at(u: float, v: float, z: float) -> Floats:
    """Return (1, 3) the point that projects to a pixel."""
    return z * np.array([[(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1.0]])


def is_occluded(point: Floats, depth: np.ndarray, radius: int = 2, matched: bool = False) -> bool:
    (occluded,) = kernels.occluded_points(HERE, point, np.array([matched]), depth, K, 0.001, radius)
    return bool(occluded)


def test_a_point_well_behind_what_was_measured_is_occluded() -> None:
    wall = np.full((180, 240), 0.5, np.float32)
    assert is_occluded(point_at(*MIDDLE, 0.5011), wall)
    assert not is_occluded(point_at(*MIDDLE, 0.5009), wall)
    assert not is_occluded(point_at(*MIDDLE, 0.4), wall)
    assert not is_occluded(point_at(*MIDDLE, 0.6), wall, matched=True)


def test_a_point_beside_an_open_pixel_is_not_occluded() -> None:
    for du, dv in ((2, 0), (-2, 2), (0, -2)):
        wall = np.full((180, 240), 0.5, np.float32)
        wall[60 + dv, 50 + du] = 0.7
        point = point_at(50.3, 59.7, 0.6)
        assert not is_occluded(point, wall)
        assert is_occluded(point, wall, radius=1)
        assert is_occluded(point_at(50.3, 59.7, 0.8), wall)


@pytest.mark.parametrize("pixel", [(-0.6, 50.0), (239.6, 50.0), (50.0, -0.6), (50.0, 179.6)])
def test_nothing_is_known_of_a_point_outside_the_image(pixel: tuple[float, float]) -> None:
    deep = np.full((180, 240), 2.0, np.float32)
    assert is_occluded(point_at(*pixel, 0.6), deep)
    inside = np.clip(pixel, (-0.4, -0.4), (239.4, 179.4))
    assert not is_occluded(point_at(*inside, 0.6), deep)


def test_nothing_is_known_of_a_point_without_depth_or_behind_the_camera() -> None:
    deep = np.full((180, 240), 2.0, np.float32)
    assert is_occluded(point_at(*MIDDLE, -0.6), deep)
    deep[80:100, 110:130] = 0.0
    assert is_occluded(point_at(*MIDDLE, 0.6), deep)


@pytest.mark.parametrize("seed", range(3))
def test_occluded_points_are_those_of_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = at.random_pose(ELL, rng)
    T[0, 3] += 0.05  # partly out of the image
    depth = at.look_at(at.placed(ELL, T)).depth.copy()
    depth[rng.random(depth.shape) < 0.3] = 0.0
    depth[:, :100] = 0.0
    matches = rng.integers(-3, 3, len(POINTS))
    for radius in (0, 2):
        seen = depth, K, 0.001, radius
        occluded = kernels.occluded_points(T, POINTS, matches >= 0, *seen)
        assert occluded.tolist() == twin.occluded_points(T, POINTS, matches, *seen).tolist()
        assert 0.1 < occluded[matches < 0].mean() < 0.95


def test_edges_are_counted_as_the_kernels_find_them() -> None:
    rng = np.random.default_rng(3)
    T = at.random_pose(ELL, rng)
    frame = at.look_at(at.placed(ELL, T))
    seen = transform_points(T, POINTS)[::2]
    index = index_boundary(seen, (TANGENTS @ T[:3, :3].T)[::2], ELL.d_max)
    group = index.points_cam[::3].copy(), index.tangents_cam[::3]
    group[0][::4] += 0.02
    beside = make_transform(None, (0.001, 0.0, 0.0)) @ T
    gates, hiding = (0.0015, 0.003, 0.9), (frame.depth, K, 0.001, 2)
    matches = match_edges(beside, POINTS, TANGENTS, *index.arrays, *gates)
    occluded = kernels.occluded_points(beside, POINTS, matches >= 0, *hiding)
    explained = explained_points(beside, POINTS, TANGENTS, *group, *gates)
    found = kernels.edge_counts(beside, POINTS, TANGENTS, *index.arrays, *gates, *hiding, *group)
    assert found == ((matches >= 0).sum(), occluded.sum(), explained.sum())
    assert 0 < found[0] < len(POINTS)
    assert 0 < found[1] < len(POINTS) - found[0]
    assert 0 < found[2] < len(group[0])


def test_a_point_is_explained_by_a_like_one_near_it() -> None:
    points, tangents = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]])
    T = make_transform(None, (0.0, 0.0, 0.5))
    for place, along, explained in (
        ((0.0, 0.0, 0.5009), (1.0, 0.0, 0.0), True),
        ((0.0, 0.0, 0.5009), (-1.0, 0.0, 0.0), True),
        ((0.0, 0.0, 0.5011), (1.0, 0.0, 0.0), False),
        ((0.0007, 0.0007, 0.5), (0.95, 0.31, 0.0), True),
        ((0.0008, 0.0008, 0.5), (1.0, 0.0, 0.0), False),
        ((0.0, 0.0, 0.5), (0.85, 0.53, 0.0), False),
        ((0.0, 0.0, 0.5), (0.0, 0.0, 0.0), False),
    ):
        found = explained_points(T, points, tangents, np.array([place]), np.array([along]), 0.001, 0.001, 0.9)
        assert found.tolist() == [explained], (place, along)


def test_a_point_is_explained_from_farther_away_along_the_line_of_sight() -> None:
    points, tangents = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]])
    T = make_transform(None, (0.3, 0.0, 0.4))
    ray, across = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    for offset, explained in ((0.0039 * ray, True), (0.0041 * ray, False), (0.0011 * across, False)):
        place = T[:3, 3] + offset
        found = explained_points(T, points, tangents, place[None], tangents, 0.001, 0.004, 0.9)
        assert found.tolist() == [explained], offset


@pytest.mark.slow
@pytest.mark.parametrize(("gate", "depth_gate"), [(0.002, 0.002), (0.01, 0.01), (0.002, 0.008)])
def test_explained_points_are_those_of_the_twin(gate: float, depth_gate: float) -> None:
    rng = np.random.default_rng(0)
    T = at.random_pose(ELL, rng)
    boundary, along = (a[::7] for a in at.wire_scene(T, ELL, rng, noise=0.001))
    along = along + 0.3 * rng.normal(size=along.shape)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    arguments = T, POINTS, TANGENTS, boundary, along, gate, depth_gate, 0.9
    found = explained_points(*arguments)
    assert found.tolist() == twin.explained_points(*arguments).tolist()
    assert 0.1 < found.mean() < 0.9
    assert (
        len(explained_points(T, POINTS, TANGENTS, np.zeros((0, 3)), np.zeros((0, 3)), gate, depth_gate, 0.9))
        == 0
    )


def test_points_near_a_sample_by_hand() -> None:
    samples, visible = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), np.array([True, False])
    T = make_transform(None, (0.0, 0.0, 0.5))
    boundary = np.array([(0.1, 0, 0.5), (0, 0.0019, 0.5), (0, 0.0021, 0.5), (0.0015, 0, 0.5015), (-0.001, 0, 0.499)])
    assert kernels.near_points(T, samples, visible, boundary, 0.002).tolist() == [1, 4]
    assert kernels.near_points(T, samples, ~visible, boundary, 0.002).tolist() == [0]
    assert kernels.near_points(T, samples, np.zeros(2, bool), boundary, 0.002).tolist() == []
    assert kernels.near_points(T, samples, visible, boundary[:0], 0.002).tolist() == []


@pytest.mark.parametrize("seed", range(3))
def test_near_points_are_those_of_the_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = at.random_pose(ELL, rng)
    boundary = T[:3, 3] + T[:3, :3] @ ELL.centre + rng.uniform(-0.04, 0.04, (300, 3))
    arguments = T, SURFACE.points, SURFACE.visible(T), boundary, 0.01
    found = kernels.near_points(*arguments)
    assert found.tolist() == twin.near_points(*arguments)
    assert 10 < len(found) < 150

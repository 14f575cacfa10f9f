"""The lowest places of a bin whose heights are known."""

import numpy as np
import pytest

from perception.geometry import transform_points
from policies.grasping.heightmap import HeightMap
from policies.grasping.low_places import low_places
from tests.policies.grasp_cell import WALL, box, look, placed, workspace

CELL = workspace(yaw=0.7)
RADIUS = 0.04


def places_in_bin(*things, radius=RADIUS, count=6):
    heights = HeightMap.from_frame(look(CELL, list(things)), CELL, wall=WALL)
    places = low_places(heights, radius, count)
    world = np.column_stack([places, np.full(len(places), WALL)])
    return transform_points(np.linalg.inv(CELL.T_world_bin), world)[:, :2]


def test_in_an_empty_bin_the_middle_comes_first() -> None:
    places = places_in_bin()
    np.testing.assert_allclose(places[0], 0.0, atol=0.003)
    assert len(places) == 6


def test_the_disc_touches_no_wall_and_places_are_apart() -> None:
    places = places_in_bin(count=50)
    assert np.all(np.abs(places) <= CELL.inner_size[:2] / 2 - RADIUS + 0.003)
    gaps = np.linalg.norm(places[:, None] - places, axis=2)[~np.eye(len(places), dtype=bool)]
    assert gaps.min() >= RADIUS / 2 - 1e-6


def test_what_is_high_is_avoided() -> None:
    heap = box((0.24, 0.26, 0.06), placed(-0.06, 0.0, 0.03))  # leaves 0.12 m on the side of positive x
    for x, _ in places_in_bin(heap, count=3):
        assert x - RADIUS > 0.055


def test_a_disc_that_does_not_fit_has_no_place() -> None:
    assert places_in_bin(radius=0.14).shape == (0, 2)


def test_places_on_a_full_pile_are_the_lowest_of_it() -> None:
    floor = [box((0.18, 0.26, h), placed(s * 0.09, 0.0, h / 2)) for s, h in ((-1, 0.03), (1, 0.05))]
    x, _ = places_in_bin(*floor)[0]
    assert x + RADIUS == pytest.approx(0.0, abs=0.005)  # as near to the middle as the lower half allows

"""Matches that begin with those of another pose, or that end with the first one found, against plain matches."""

import numpy as np
import pytest

from perception.geometry import make_transform, rotation_about
from perception.pose.verification import _matching_kernels as kernels
from perception.pose.verification.boundary_index import index_boundary
from tests.perception.pose import observed_part as at

ELL = at.ell()
MODEL = at.wire_model(ELL)


@pytest.mark.parametrize("gates", [(0.01, 0.01), (0.03, 0.03), (0.003, 0.02)])
def test_matches_are_the_same_whatever_they_were_before(gates: tuple[float, float]) -> None:
    rng = np.random.default_rng(7)
    index = index_boundary(*at.scattered(rng), ELL.d_max)
    edges = MODEL.points, MODEL.tangents
    for shift in (0.0, 0.0005, 0.004):
        T = at.random_pose(ELL, rng)
        near = make_transform(rotation_about((1.0, 0.0, 0.0), 10 * shift), [shift, 0.0, shift]) @ T
        want = kernels.match_edges(near, *edges, *index.arrays, *gates, 0.8)
        before = kernels.match_edges(T, *edges, *index.arrays, *gates, 0.8)
        anything = rng.integers(-1, len(index), len(before))
        for matches in (before, anything, want.copy()):
            kernels.rematch_edges(matches, near, *edges, *index.arrays, *gates, 0.8)
            assert matches.tolist() == want.tolist()
        assert (want >= 0).any()


def test_of_equally_near_points_the_first_one_is_the_match_whichever_it_was() -> None:
    point, tangent = np.array([[0.0, 0.0, 0.5]]), np.array([[0.0, 1.0, 0.0]])
    beside = np.array([[0.002, 0.0, 0.5], [-0.002, 0.0, 0.5], [0.004, 0.0, 0.5]])
    index = index_boundary(beside, np.tile(tangent, (3, 1)), 0.1)
    (want,) = kernels.match_edges(np.eye(4), point, tangent, *index.arrays, 0.01, 0.01, 0.9)
    assert abs(index.points_cam[want, 0]) == 0.002
    for before in (0, 1, 2):
        matches = np.array([before])
        kernels.rematch_edges(matches, np.eye(4), point, tangent, *index.arrays, 0.01, 0.01, 0.9)
        assert matches.tolist() == [want]


@pytest.mark.parametrize("gates", [(0.001, 0.001), (0.03, 0.03), (0.003, 0.02)])
def test_points_that_match_at_all_are_those_with_a_nearest_match(gates: tuple[float, float]) -> None:
    rng = np.random.default_rng(9)
    index = index_boundary(*at.scattered(rng), ELL.d_max)
    for _ in range(3):
        arguments = at.random_pose(ELL, rng), MODEL.points, MODEL.tangents, *index.arrays, *gates, 0.8
        matches = kernels.match_edges(*arguments)
        assert kernels.matched_points(*arguments).tolist() == (matches >= 0).tolist()
        assert gates[0] == 0.001 or (matches >= 0).any()


def test_points_behind_the_camera_and_at_it_explain_nothing_and_match_nothing() -> None:
    place, along = np.array([[0.0, 0.0, 0.5]]), np.array([[1.0, 0.0, 0.0]])
    index = index_boundary(place, along, 0.1)
    for z in (-1.0, -0.5, 0.0):
        T = make_transform(translation=[0.0, 0.0, z])
        origin = np.zeros((1, 3))
        assert not kernels.matched_points(T, origin, along, *index.arrays, 0.01, 0.02, 0.9).any()
        assert not kernels.explained_points(T, origin, along, place, along, 0.01, 0.02, 0.9).any()
    near = np.array([[0.0, 0.0, 0.005]])  # nearer to the camera than the gate: not sorted out by its place in the image
    beside = near + np.array([0.006, 0.0, 0.0])
    assert kernels.explained_points(np.eye(4), near, along, beside, along, 0.01, 0.01, 0.9).all()

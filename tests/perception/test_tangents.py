"""Tangents from neighbours in space: along edges, in any frame, none for lonely points."""

import numpy as np
import pytest

from perception.geometry import rotation_about
from perception.tangents import space_tangents

LINE = np.column_stack([np.linspace(0.0, 0.1, 41), np.zeros(41), np.ones(41)])


def test_the_tangents_of_a_straight_edge_lie_along_it_in_any_frame() -> None:
    turn = rotation_about((1.0, 2.0, 3.0), 0.7)
    tangents, straight = space_tangents(LINE @ turn.T, 0.1)
    np.testing.assert_allclose(np.abs(tangents @ turn[:, 0]), 1.0, atol=1e-9)
    np.testing.assert_allclose(straight, 1.0, atol=1e-9)


def test_an_edge_is_not_straight_at_a_corner() -> None:
    corner = np.vstack([LINE, np.column_stack([np.zeros(40), np.linspace(0.0025, 0.1, 40), np.ones(40)])])
    tangents, straight = space_tangents(corner, 0.1)
    assert straight[0] < 0.9 < straight[32]
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0)


def test_points_without_neighbours_have_no_tangent() -> None:
    points = np.vstack([LINE, [[1.0, 1.0, 1.0]], [[2.0, 1.0, 1.0]], [[2.0, 1.0, 1.001]]])
    tangents, straight = space_tangents(points, 0.1)
    assert not tangents[-3:].any()
    assert not straight[-3:].any()
    coinciding, _ = space_tangents(np.ones((5, 3)), 0.1)
    assert not coinciding.any()
    assert space_tangents(np.zeros((0, 3)), 0.1)[0].shape == (0, 3)


def test_nonsense_is_named() -> None:
    with pytest.raises(ValueError, match=r"points must be \(N, 3\), got \(4, 2\)"):
        space_tangents(np.zeros((4, 2)), 0.1)
    with pytest.raises(ValueError, match="points must be finite: leave out pixels without a measurement"):
        space_tangents(np.vstack([LINE, [[np.nan, 0.0, 1.0]]]), 0.1)
    with pytest.raises(ValueError, match="d_max must be positive and finite, got 0"):
        space_tangents(LINE, 0)

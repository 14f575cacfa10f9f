"""The index of boundary points against plain loops over all of them."""

import numpy as np
import pytest

from perception.geometry import rotation_about
from perception.pose.verification.boundary_index import index_boundary
from tests.perception.pose import observed_part as at
from tests.reference import refine_twin as twin

ELL = at.ell()
MODEL = at.wire_model(ELL)
LEANING = at.pose_of(ELL, rotation_about((1.0, 0.5, 0.0), 2.5))


@pytest.mark.slow
@pytest.mark.parametrize(("gate", "depth_gate"), [(0.001, 0.0), (0.01, 0.0), (0.03, 0.0), (0.003, 0.02), (0.01, 0.03)])
def test_matches_are_those_of_the_twin(gate: float, depth_gate: float) -> None:
    rng = np.random.default_rng(5)
    points, tangents = at.scattered(rng)
    index = index_boundary(points, tangents, ELL.d_max)
    for _ in range(3):
        T = at.random_pose(ELL, rng)
        found = index.match(T, MODEL.points, MODEL.tangents, gate=gate, max_angle=0.6, depth_gate=depth_gate)
        arguments = (T, MODEL.points, MODEL.tangents, points, tangents, gate, np.cos(0.6))
        expected = twin.match_edges(*arguments, max(gate, depth_gate))
        assert np.where(found >= 0, index.order[found], -1).tolist() == expected.tolist()
        assert gate == 0.001 or (expected >= 0).any()


def test_a_stray_point_enlarges_the_cells_and_not_the_grid() -> None:
    points, tangents = at.scattered(np.random.default_rng(5))
    stray = index_boundary(np.vstack([points, [500.0, 0.0, 0.5]]), np.vstack([tangents, [1.0, 0.0, 0.0]]), ELL.d_max)
    assert len(stray.starts) < 2**21
    plain = index_boundary(points, tangents, ELL.d_max)
    matches = [
        index.order[index.match(LEANING, MODEL.points, MODEL.tangents, gate=0.03, max_angle=1.5)]
        for index in (stray, plain)
    ]
    assert matches[0].tolist() == matches[1].tolist()
    assert len(stray) == len(plain) + 1


def test_bad_boundary_points_are_refused() -> None:
    points, tangents = np.array([[0.0, 0.0, 0.5]]), np.array([[1.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match="points_cam must hold at least one point, got none"):
        index_boundary(points[:0], tangents[:0], 0.1)
    with pytest.raises(ValueError, match=r"points_cam must be \(N, 3\)"):
        index_boundary(points[0], tangents, 0.1)
    with pytest.raises(ValueError, match=r"tangents_cam must be \(1, 3\), got \(2, 3\)"):
        index_boundary(points, np.tile(tangents, (2, 1)), 0.1)
    with pytest.raises(ValueError, match="points_cam and tangents_cam must be finite"):
        index_boundary(points, tangents * np.nan, 0.1)
    with pytest.raises(ValueError, match=r"before the camera \(z > 0\), got z = -0.5"):
        index_boundary(-points, tangents, 0.1)
    with pytest.raises(ValueError, match="d_max must be positive, got 0"):
        index_boundary(points, tangents, 0.0)

"""A ball, whose orientation is free: metrics and clustering count its position alone."""

import numpy as np
import pytest
import trimesh

from perception.geometry import make_transform, random_rotation
from perception.metrics.bop_error import mssd
from perception.metrics.pose_distance import PoseSpace
from perception.metrics.pose_errors import is_recognised, pose_error, recognition_distances
from perception.part import PartModel, Symmetry
from perception.pose.clustering import rotations_within

BALL = PartModel.from_mesh("ball", trimesh.creation.icosphere(subdivisions=3, radius=0.02), Symmetry(sphere=True))
PLACE = (0.005, -0.01, 0.5)


def test_metrics_count_the_position_alone() -> None:
    rng = np.random.default_rng(4)
    true = make_transform(random_rotation(rng), PLACE)
    turned = make_transform(random_rotation(rng), PLACE)
    shifted = make_transform(random_rotation(rng), np.add(PLACE, (0.003, 0, 0.004)))
    error = pose_error(shifted, true, BALL)
    assert (error.translation, error.rotation) == (pytest.approx(0.005), 0.0)
    assert is_recognised(pose_error(turned, true, BALL), BALL.d_max)
    np.testing.assert_allclose(recognition_distances(np.stack([turned]), np.stack([true]), BALL), 0, atol=1e-12)
    assert mssd(turned, true, BALL) == pytest.approx(0, abs=1e-9)
    assert mssd(shifted, true, BALL) == pytest.approx(0.005, rel=1e-6)
    assert PoseSpace.of(BALL).distance(turned, true) == pytest.approx(0, abs=1e-9)
    assert PoseSpace.of(BALL).distance(shifted, true) == pytest.approx(0.005, rel=1e-6)
    assert rotations_within(turned[:3, :3], true[None, :3, :3], BALL.symmetry, 1e-6).tolist() == [True]

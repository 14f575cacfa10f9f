"""Poses from boundary points alone: found again by their edges, and what could not be checked is said."""

import numpy as np
import pytest

from perception.geometry import Floats
from perception.instance import Instance
from perception.metrics.pose_errors import pose_error
from perception.pose import edge_estimator as module
from perception.pose.edge_estimator import UNCHECKED, EdgeEstimatorConfig, EdgePoseEstimator
from perception.pose.model import appearances
from perception.pose.verification.boundary_index import BoundaryIndex
from perception.pose.verification.refinement import EdgeRefinement, RefinedPose, refine_edges
from tests.perception.pose.estimator_scene import CONFIG
from tests.perception.pose.test_estimator import BOTH, ELL, PAIR


@pytest.fixture(scope="module")
def estimator() -> EdgePoseEstimator:
    """Return an estimator with few views, which are made in no time."""
    made = module.edge_appearances
    module.edge_appearances = lambda part, config: appearances.edge_appearances(part, config, subdivisions=2)
    try:
        return EdgePoseEstimator(ELL, EdgeEstimatorConfig(search=CONFIG))
    finally:
        module.edge_appearances = made


def test_parts_are_found_without_a_frame(estimator: EdgePoseEstimator) -> None:
    poses = estimator.estimate(BOTH.boundary.points_cam, BOTH.groups())
    assert sorted(pose.instance_idx for pose in poses) == [0, 1]
    for pose in poses:
        error = pose_error(pose.T_cam_part, PAIR[pose.instance_idx], ELL)
        assert error.translation < 0.002
        assert np.degrees(error.rotation) < 3.0
        assert pose.verified
        assert pose.unchecked == UNCHECKED


def test_points_that_are_no_part_are_not_verified(estimator: EdgePoseEstimator) -> None:
    rng = np.random.default_rng(0)
    points = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.03, 0.03, (300, 3))
    poses = estimator.estimate(points, [Instance(point_idx=np.arange(300), score=1.0)])
    assert not any(pose.verified for pose in poses)


def test_nothing_comes_of_nothing(estimator: EdgePoseEstimator) -> None:
    assert estimator.estimate(np.zeros((0, 3)), []) == []
    assert estimator.estimate(BOTH.boundary.points_cam, []) == []
    lonely = [Instance(point_idx=np.array([0]), score=1.0)]
    assert estimator.estimate(BOTH.boundary.points_cam, lonely) == []


def test_nonsense_is_named(estimator: EdgePoseEstimator) -> None:
    with pytest.raises(ValueError, match="must lie before the camera"):
        estimator.estimate(-BOTH.boundary.points_cam, BOTH.groups())
    with pytest.raises(ValueError, match="finalists must be at least 1, got 0"):
        EdgeEstimatorConfig(finalists=0)
    for name in ("min_explained", "min_edges"):
        with pytest.raises(ValueError, match=rf"{name} must be in \[0, 1\], got 1.5"):
            EdgeEstimatorConfig(**{name: 1.5})


@pytest.mark.parametrize("limits", [{"min_edges": 1.0, "min_explained": 0.0}, {"min_edges": 0.0, "min_explained": 1.0}])
def test_a_pose_is_verified_by_its_edges_and_by_the_points_that_it_explains(
    estimator: EdgePoseEstimator, limits: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimator, "config", EdgeEstimatorConfig(search=CONFIG, **limits))
    poses = estimator.estimate(BOTH.boundary.points_cam, BOTH.groups())
    assert len(poses) == 2
    assert not any(pose.verified for pose in poses)


def test_the_finalists_are_refined_on_all_edges(estimator: EdgePoseEstimator, monkeypatch: pytest.MonkeyPatch) -> None:
    refined: list[int] = []

    def refine(T: Floats, edges: object, index: BoundaryIndex, settings: EdgeRefinement) -> RefinedPose:
        refined.append(id(edges))
        return refine_edges(T, edges, index, settings)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "refine_edges", refine)
    estimator.estimate(BOTH.boundary.points_cam, BOTH.groups())
    assert 0 < refined.count(id(estimator._edges)) <= 2 * estimator.config.finalists

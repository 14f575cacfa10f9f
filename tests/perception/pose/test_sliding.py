"""Long parts along their axes: visible ends decide, and hidden ones cost the score."""

import numpy as np
import trimesh

from perception.geometry import Floats, make_transform, rotation_about
from perception.part import PartModel, Symmetry
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model.slides import slides
from perception.pose.pose_estimate import PoseEstimate
from tests.perception.pose import observed_part as at
from tests.perception.pose.estimator_scene import quick_estimator, scene_of

LENGTH, SIDE = 0.09, 0.004


def rod() -> PartModel:
    """Return a rod whose turn about its axis is free and whose ends are alike; its mesh is square for its wires."""
    ends = Symmetry(rotations=np.array([np.eye(3), rotation_about((0, 0, 1), np.pi)]), axis=np.array([1.0, 0.0, 0.0]))
    return PartModel.from_mesh("rod", trimesh.creation.box((LENGTH, SIDE, SIDE)), ends)


ROD = rod()
POSE = at.pose_of(ROD, rotation_about((0, 0, 1), 0.15) @ rotation_about((1, 0, 0), 0.6))


def hider(x: float, width: float = 0.04) -> trimesh.Trimesh:
    """Return a plate over the rod's axis, as far along it from its centre as ``x`` [m]."""
    plate = trimesh.creation.box((width, 0.03, 0.003))
    return plate.apply_transform(POSE @ make_transform(rotation_about((1, 0, 0), -0.6), (x, 0.0, 0.0)) @ LIFT)


LIFT = make_transform(translation=(0.0, 0.0, -0.012))


def estimated(*hiders: trimesh.Trimesh) -> PoseEstimate:
    scene = scene_of(ROD, POSE, hiders=hiders)
    (estimate,) = ESTIMATOR.estimate_groups(scene.boundary, scene.groups(), scene.frame)
    assert estimate is not None
    return estimate


def slid(T_cam_part: Floats) -> float:
    """Return how far a pose is off along the rod's axis [m]."""
    return abs(float(POSE[:3, 0] @ (T_cam_part[:3, 3] - POSE[:3, 3])))


ESTIMATOR = quick_estimator(ROD, EstimatorConfig())


def test_visible_ends_decide() -> None:
    whole = estimated()
    assert slid(whole.T_cam_part) < 0.001
    assert whole.score > 0.9
    half = estimated(hider(0.035))
    assert slid(half.T_cam_part) < 0.002
    assert half.score > 0.9


def test_hidden_ends_cost_the_score() -> None:
    assert estimated(hider(-0.035), hider(0.035)).score < 0.7


def test_a_wrong_hypothesis_slides_to_the_ends() -> None:
    """The only hypothesis given is a quarter of the rod off along its axis."""
    scene = scene_of(ROD, POSE)
    wrong = POSE @ make_transform(translation=(0.22 * ROD.d_max, 0.0, 0.0))
    (search,) = ESTIMATOR.search_groups(scene.boundary, scene.groups(), scene.frame)
    search._hypotheses = []
    search.add(wrong[None])
    best = search.best()
    assert best is not None
    assert slid(best.T_cam_part) < 0.001


def test_slides_run_both_ways_along_the_axis() -> None:
    motions = slides(ROD)
    assert len(motions) == 6
    np.testing.assert_array_equal(motions[:, :3, :3], np.tile(np.eye(3), (6, 1, 1)))
    np.testing.assert_allclose(sorted(motions[:, 0, 3] / ROD.d_max), [-0.33, -0.22, -0.11, 0.11, 0.22, 0.33], atol=1e-9)
    np.testing.assert_allclose(motions[:, 1:3, 3], 0.0, atol=1e-12)
    assert len(slides(at.ell())) == 0

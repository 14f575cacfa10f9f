"""The noise of a frame, and what it costs the scores."""

from dataclasses import replace

import numpy as np
import pytest

from perception.frame import Frame, Workspace, bin_region
from perception.geometry import make_transform, rotation_about
from perception.pose import hypothesis_scoring
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.verification.confidence import ConfidenceConfig
from perception.pose.verification.verification import surface_tolerance
from tests.perception.pose import observed_part as at
from tests.perception.pose.estimator_scene import quick_estimator, scene_of

ELL = at.ell()
POSE = at.random_pose(ELL, np.random.default_rng(3))


def noisy(frame: Frame, sigma: float) -> Frame:
    errors = np.random.default_rng(1).normal(size=frame.depth.shape)
    return replace(frame, depth=(frame.depth + sigma * errors).astype(np.float32))


@pytest.mark.parametrize("sigma", [0.0, 0.0005, 0.002])
def test_the_noise_of_a_frame_is_measured(sigma: float) -> None:
    estimator = quick_estimator(ELL, EstimatorConfig())
    frame = noisy(at.look_at(at.placed(ELL, POSE)), sigma)
    assert estimator._noise(frame) == pytest.approx(sigma, rel=0.25, abs=0.0002)
    assert estimator._noise(at.framed(np.zeros(at.SIZE[::-1], np.float32))) == 0.0


def test_noise_lowers_the_scores_and_changes_no_pose() -> None:
    scene = scene_of(ELL, POSE)
    frame = noisy(scene.frame, 0.002)
    blind = EstimatorConfig(confidence=ConfidenceConfig(noise_weight=0.0))
    scores = []
    for config in (EstimatorConfig(), blind):
        (estimate,) = quick_estimator(ELL, config).estimate_groups(scene.boundary, scene.groups(), frame)
        assert estimate is not None
        scores.append((estimate.score, estimate.T_cam_part.tobytes()))
    assert scores[0][0] < scores[1][0]
    assert scores[0][1] == scores[1][1]


def test_only_the_noise_in_the_bin_counts() -> None:
    scene = scene_of(ELL, POSE)
    T_world_bin = make_transform(rotation_about((1, 0, 0), np.pi), (0.0, 0.0, at.FLOOR))
    workspace = Workspace(T_world_bin=T_world_bin, inner_size=np.array([0.04, 0.04, 0.05]))
    estimator = quick_estimator(ELL, EstimatorConfig()).within(workspace)
    frame = noisy(scene.frame, 0.002)
    u0, v0, u1, v1 = bin_region(workspace, frame.K, frame.T_world_cam, at.SIZE, margin=0.0, headroom=0.0)
    assert (u1 - u0) * (v1 - v0) < 0.5 * frame.depth.size
    depth = frame.depth.copy()
    depth[v0:v1, u0:u1] = scene.frame.depth[v0:v1, u0:u1]
    assert estimator._noise(replace(frame, depth=depth)) == estimator._noise(scene.frame) < estimator._noise(frame)


def test_gates_and_tolerances_follow_the_noise_up_to_a_share_of_the_part() -> None:
    plain = EstimatorConfig()
    quiet = plain.at_noise(0.0002, 0.1)
    assert replace(quiet, joint_refinement=plain.joint_refinement) == plain
    assert quiet.joint_refinement.depth_noise == 0.0002
    assert plain.at_noise(0.0, 0.1).joint_refinement.depth_noise == 3e-5
    noisy = plain.at_noise(0.002, 0.1)
    for refinement in (noisy.rough_edges, noisy.quick_edges, noisy.quick_surface, noisy.edge_refinement):
        assert refinement.finest == pytest.approx(0.006)
    assert noisy.joint_refinement.depth_noise == 0.002
    assert surface_tolerance(0.1, noisy.verification) == pytest.approx(0.004)
    assert surface_tolerance(0.1, plain.verification) == pytest.approx(0.002)
    # A bin full of small round parts looks noisy: their curvature is not the sensor's.
    assert plain.at_noise(0.002, 0.01) == plain.at_noise(0.0005, 0.01)


def test_a_hypothesis_is_judged_once_though_its_group_is_asked_several_times(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, judged = scene_of(ELL, POSE), []
    find_mismatch = hypothesis_scoring.find_mismatch
    monkeypatch.setattr(
        hypothesis_scoring, "find_mismatch", lambda T, *others: judged.append(T.tobytes()) or find_mismatch(T, *others)
    )
    estimator = quick_estimator(ELL, EstimatorConfig())
    (search,) = estimator.search_groups(scene.boundary, scene.groups(), scene.frame)
    first, again = search.best(), search.best()
    assert first is not None
    assert again is not None
    assert (first.score, first.mismatch, first.expected_error) == (again.score, again.mismatch, again.expected_error)
    assert len(judged) == len(set(judged)) > 0

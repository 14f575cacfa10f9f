"""The pipeline measures the bin: four blocks in a bin that stands elsewhere than believed."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from perception.bin import find_bin, reconcile
from perception.diagnosis import BinFacts, log
from perception.frame import Frame, Workspace
from perception.geometry import invert_transform, make_transform, rotation_about, rotation_angle
from perception.pipeline import STAGES, Perception, Pipeline
from tests.perception.block_scene import KnowingPredictor
from tests.perception.diagnosis import bin_scene as scene
from tests.perception.pose.estimator_scene import quick_estimator

ESTIMATOR = quick_estimator(scene.ELL)
FRAME = scene.good()[0]
WRONG = make_transform(rotation_about((1, 2, 0.5), np.deg2rad(2)), (0.006, -0.006, 0.03))
ELSEWHERE = Workspace(T_world_bin=WRONG @ scene.BIN.T_world_bin, inner_size=scene.BIN.inner_size)
BELIEVED_CAM = replace(FRAME, T_world_cam=FRAME.T_world_cam @ WRONG)


def pipeline(workspace: Workspace, **settings: object) -> Pipeline:
    estimator = copy(ESTIMATOR)
    estimator.workspace = workspace
    return Pipeline(KnowingPredictor(scene.true_groups), estimator, workspace, **settings)


def off(T_a: np.ndarray, T_b: np.ndarray) -> tuple[float, float]:
    """Return how far two poses are apart [mm and deg]."""
    T = invert_transform(T_a) @ T_b
    return 1000 * float(np.linalg.norm(T[:3, 3])), float(np.degrees(rotation_angle(T[:3, :3])))


def world_poses(seen: Perception) -> list[np.ndarray]:
    return [seen.T_world_cam @ pose.T_cam_part for pose in seen.poses]


def test_parts_are_found_in_a_bin_that_stands_elsewhere() -> None:
    seen = pipeline(ELSEWHERE).perceive(FRAME)
    blind = pipeline(ELSEWHERE, measure_bin=False).perceive(FRAME)
    assert len(seen.poses) == len(scene.POSES)
    assert len(blind.poses) < len(scene.POSES)
    distance, angle = off(seen.workspace.T_world_bin, scene.BIN.T_world_bin)
    assert distance < 1.0
    assert angle < 0.3
    np.testing.assert_array_equal(seen.T_world_cam, FRAME.T_world_cam)
    assert tuple(seen.ms) == STAGES
    assert tuple(blind.ms) == STAGES[1:]
    assert (blind.bin, blind.report.bin) == (None, None)


def test_the_report_says_how_far_off_the_bin_was() -> None:
    seen = pipeline(ELSEWHERE).perceive(FRAME)
    distance, angle = off(scene.BIN.T_world_bin, ELSEWHERE.T_world_bin)
    facts = seen.report.bin
    assert facts.measured
    assert 1000 * facts.distance == pytest.approx(distance, abs=1.0)
    assert np.degrees(facts.angle) == pytest.approx(angle, abs=0.3)
    assert "the bin was measured by floor, rim, 4 walls: " in str(seen.report)
    assert f"{1000 * facts.distance:.1f} mm and {np.degrees(facts.angle):.2f} degrees from where it was" in str(facts)


def test_a_trusted_bin_corrects_the_camera() -> None:
    seen = pipeline(scene.BIN, trust="bin").perceive(BELIEVED_CAM)
    distance, angle = off(seen.T_world_cam, FRAME.T_world_cam)
    assert distance < 2.5
    assert angle < 0.3
    np.testing.assert_array_equal(seen.workspace.T_world_bin, scene.BIN.T_world_bin)
    found = world_poses(seen)
    assert len(found) == len(scene.POSES)
    for T in found:
        assert min(np.linalg.norm(T[:3, 3] - true[:3, 3]) for true in scene.POSES) < 0.0015


def test_a_trusted_camera_keeps_its_pose() -> None:
    seen = pipeline(scene.BIN).perceive(BELIEVED_CAM)
    np.testing.assert_array_equal(seen.T_world_cam, BELIEVED_CAM.T_world_cam)
    assert len(seen.poses) == len(scene.POSES)


def test_the_given_pose_is_kept_where_the_bin_is_not_seen() -> None:
    empty = replace(FRAME, depth=np.zeros_like(FRAME.depth))
    seen = pipeline(ELSEWHERE).perceive(empty)
    np.testing.assert_array_equal(seen.workspace.T_world_bin, ELSEWHERE.T_world_bin)
    assert seen.workspace.translation_std == 0.005
    assert ELSEWHERE.translation_std == 0.0
    assert not seen.report.bin.measured
    assert "the bin was not measured: hardly any pixel has a depth" in str(seen.report)


def test_a_bin_of_another_size_is_logged(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "_logged", set())
    stated = replace(scene.BIN, inner_size=scene.BIN.inner_size - np.array([0.008, 0.008, 0.0]))
    seen = pipeline(stated).perceive(FRAME)
    (cause,) = (cause for cause in seen.report.causes if cause.name == "bin_size")
    assert [record.message for record in caplog.records].count(cause.text) == 1


@pytest.mark.parametrize("trust", ["camera", "bin"])
def test_a_principal_point_with_swapped_coordinates_is_named_though_the_parts_are_found(
    trust: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log, "_logged", set())
    K = FRAME.K.copy()
    K[:2, 2] = K[1::-1, 2]
    seen = pipeline(scene.BIN, trust=trust).perceive(replace(FRAME, K=K))
    assert [cause.name for cause in seen.report.causes] == ["camera_matrix"]
    assert log._logged == {"camera_matrix"}
    assert len(seen.poses) == len(scene.POSES)


def test_the_given_estimator_is_left_as_it_is() -> None:
    made = pipeline(ELSEWHERE)
    made.perceive(FRAME)
    assert made.estimator.workspace is ELSEWHERE
    assert made.workspace is ELSEWHERE


def test_facts_of_a_table_say_that_only_height_and_tilt_count() -> None:
    fit = find_bin(FRAME, scene.BIN.inner_size, scene.BIN)
    table = replace(fit, points={"floor": 100})
    assert "by floor: " in str(BinFacts.of(table, scene.BIN))
    assert "height and tilt only" in str(BinFacts.of(table, scene.BIN))


@pytest.mark.parametrize("make", [lambda: pipeline(scene.BIN, trust="floor"), lambda: reconcile_with("floor")])
def test_only_camera_or_bin_can_be_trusted(make: object) -> None:
    with pytest.raises(ValueError, match="trust must be one of camera, bin, got 'floor'"):
        make()


def reconcile_with(trust: str) -> tuple[Frame, Workspace]:
    return reconcile(FRAME, scene.BIN, find_bin(FRAME, scene.BIN.inner_size, scene.BIN), trust)

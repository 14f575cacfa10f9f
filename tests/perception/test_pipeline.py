"""From a frame to poses, with a predictor that knows the groups."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from perception import pipeline as module
from perception.boundary import BoundaryCloud, BoundarySettings, extract_boundary
from perception.frame import Frame
from perception.instance import Instance, labels_of
from perception.metrics.pose_errors import pose_error
from perception.part import PartModel
from perception.pipeline import STAGES, Perception, Pipeline, perceive_by
from perception.pose.estimator import PoseEstimator
from perception.pose.estimator_config import EstimatorConfig
from perception.runtime.threads import use_threads
from perception.segmentation import weights
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.weights import WeightsError
from tests.perception.block_scene import BIN, ELL, POSES, KnowingPredictor, one_group, owners, photographed, true_groups
from tests.perception.pose import observed_part as at
from tests.perception.pose.estimator_scene import quick_estimator

ESTIMATOR = quick_estimator(ELL)
PREDICTOR = KnowingPredictor(true_groups)
FRAME = photographed(*POSES)
SEEN = Pipeline(PREDICTOR, ESTIMATOR, BIN).perceive(FRAME)


def assert_poses(seen: Perception) -> None:
    assert sorted(pose.instance_idx for pose in seen.poses) == [0, 1]
    for pose in seen.poses:
        error = pose_error(pose.T_cam_part, POSES[pose.instance_idx], ELL)
        assert error.translation < 0.001
        assert np.degrees(error.rotation) < 1.0


def test_a_frame_becomes_points_groups_and_poses() -> None:
    expected = extract_boundary(FRAME, BIN)
    np.testing.assert_array_equal(SEEN.boundary.points_cam, expected.points_cam)
    assert len(expected) > 500
    owner = owners(SEEN.boundary, *POSES)
    for k, segment in enumerate(SEEN.segments):
        assert segment.point_idx.tolist() == np.flatnonzero(owner == k).tolist()
        assert len(segment.point_idx) > 200
    assert_poses(SEEN)
    scores = [pose.score for pose in SEEN.poses]
    assert scores == sorted(scores, reverse=True)


def test_objects_of_another_kind_are_named() -> None:
    with pytest.raises(ValueError, match=r"frame must be a Frame, got array.*: it holds depth, K, T_world_cam"):
        Pipeline(PREDICTOR, ESTIMATOR, BIN).perceive(FRAME.depth)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"workspace must be a Workspace, got \[1, 2, 3\]"):
        Pipeline(PREDICTOR, ESTIMATOR, [1, 2, 3])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"part must be a PartModel, got 'tee': load_part\(\.\.\.\)\.model is one"):
        Pipeline.for_part("tee", BIN)  # type: ignore[arg-type]


def test_the_predictor_sees_the_whole_frame_in_cells_of_the_part() -> None:
    (boundary, surface, d_max) = PREDICTOR.asked[0]
    assert boundary is SEEN.boundary
    assert d_max == ELL.d_max
    assert surface.depth.max() == pytest.approx(at.FLOOR, abs=0.001)
    assert surface.depth[surface.depth > 0].min() == pytest.approx(FRAME.depth.min(), abs=0.003)


def test_any_segmentation_goes_the_same_way_to_poses() -> None:
    seen = perceive_by(true_groups, ESTIMATOR, FRAME, BIN)
    assert_poses(seen)
    assert [pose.T_cam_part.tobytes() for pose in seen.poses] == [pose.T_cam_part.tobytes() for pose in SEEN.poses]
    assert tuple(seen.ms) == STAGES[1:]


def test_every_segment_has_its_best_pose_verified_or_not() -> None:
    assert [estimate.instance_idx for estimate in SEEN.estimates if estimate is not None] == [0, 1]
    strict = quick_estimator(ELL, replace(ESTIMATOR.config, min_score=1.0))
    seen = Pipeline(PREDICTOR, strict, BIN).perceive(FRAME)
    assert seen.poses == []
    assert [estimate.score for estimate in seen.estimates if estimate is not None] == [
        estimate.score for estimate in SEEN.estimates if estimate is not None
    ]


def test_every_stage_is_timed() -> None:
    assert tuple(SEEN.ms) == STAGES
    assert all(0 <= ms < np.inf for ms in SEEN.ms.values())
    assert sum(SEEN.ms.values()) > 0.1


def test_poses_put_the_groups_right() -> None:
    """One point in five has the other block's group; in the end few have."""
    rng = np.random.default_rng(0)

    def mixed(boundary: BoundaryCloud) -> list[Instance]:
        owner = owners(boundary, *POSES)
        swapped = np.where((rng.random(len(owner)) < 0.2) & (owner >= 0), 1 - owner, owner)
        return [Instance(point_idx=np.flatnonzero(swapped == k), score=0.9) for k in range(2)]

    seen = Pipeline(KnowingPredictor(mixed), ESTIMATOR, BIN).perceive(FRAME)
    truth = owners(seen.boundary, *POSES)
    before, after = (labels_of(groups, len(truth)) for groups in (seen.segments, seen.instances))
    assert np.mean(before == truth) < 0.85
    assert len(seen.instances) == 2
    pairs = {(a, b): np.count_nonzero((after == a) & (truth == b)) for a in range(2) for b in range(2)}
    right = max(pairs[0, 0] + pairs[1, 1], pairs[0, 1] + pairs[1, 0])
    assert right > 0.9 * np.count_nonzero(truth >= 0)


def test_two_blocks_in_one_group_are_both_found() -> None:
    seen = Pipeline(KnowingPredictor(one_group), ESTIMATOR, BIN).perceive(FRAME)
    assert len(seen.segments) == 1
    assert len(seen.groups) == len(seen.estimates) == 2
    assert sorted(pose.instance_idx for pose in seen.poses) == [0, 1]
    truth = owners(seen.boundary, *POSES)
    for pose in seen.poses:
        errors = [pose_error(pose.T_cam_part, T, ELL) for T in POSES]
        k = int(np.argmin([error.translation for error in errors]))
        assert errors[k].translation < 0.001
        assert np.degrees(errors[k].rotation) < 1
        if pose.instance_idx == 1:  # the group of what was left over lies on the part that was found in it
            assert np.mean(truth[seen.groups[1].point_idx] == k) > 0.8
    assert len(seen.instances) >= 2


def test_a_part_is_not_found_again_in_what_its_pose_leaves_over(monkeypatch: pytest.MonkeyPatch) -> None:
    boundary = extract_boundary(FRAME, BIN)
    idx = np.flatnonzero(owners(boundary, *POSES) == 0)
    group, half = (Instance(point_idx=points, score=1.0) for points in (idx, idx[: len(idx) // 2]))
    (sure,) = ESTIMATOR.estimate_groups(boundary, [group], FRAME)
    assert sure is not None
    monkeypatch.setattr("perception.pose.estimator.leftover_groups", lambda *_: [half])
    assert ESTIMATOR.estimate_leftovers(boundary, [group], [sure], FRAME) == ([half], [None])
    doubtful = replace(sure, score=ESTIMATOR.config.min_score)
    _, (again,) = ESTIMATOR.estimate_leftovers(boundary, [group], [doubtful], FRAME)
    assert again is not None  # it is better than what it repeats
    assert again.instance_idx == 1
    assert again.score > doubtful.score
    assert ESTIMATOR.verified([doubtful, again]) == [again]


def test_nothing_comes_of_nothing() -> None:
    dark = Frame(grey=FRAME.grey, depth=np.zeros_like(FRAME.depth), K=FRAME.K, T_world_cam=FRAME.T_world_cam)
    for frame in (photographed(), dark):
        seen = Pipeline(KnowingPredictor(one_group), ESTIMATOR, BIN).perceive(frame)
        assert len(seen.boundary) == 0
        assert (seen.segments, seen.poses, seen.instances) == ([], [], [])
        assert tuple(seen.ms) == STAGES


def test_without_groups_there_are_no_poses() -> None:
    seen = Pipeline(KnowingPredictor(lambda boundary: []), ESTIMATOR, BIN).perceive(FRAME)
    assert len(seen.boundary) > 500
    assert (seen.poses, seen.instances) == ([], [])


def test_only_verified_poses_are_given() -> None:
    strict = quick_estimator(ELL, replace(ESTIMATOR.config, min_score=1.0))
    seen = Pipeline(PREDICTOR, strict, BIN).perceive(FRAME)
    assert seen.poses == []
    assert len(seen.instances) == 2  # a pose that is not sure enough to act on still tells points apart


def test_the_same_frame_gives_the_same_bits() -> None:
    again = Pipeline(PREDICTOR, ESTIMATOR, BIN).perceive(FRAME)
    assert [p.T_cam_part.tobytes() for p in again.poses] == [p.T_cam_part.tobytes() for p in SEEN.poses]
    for a, b in zip(again.instances, SEEN.instances, strict=True):
        assert a.point_idx.tobytes() == b.point_idx.tobytes()


def test_a_pipeline_for_a_part_has_its_weights_and_models(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def for_part(part: PartModel) -> SegmentationPredictor:
        asked.append(part)
        return PREDICTOR

    def estimator(part: object, config: object, workspace: object) -> PoseEstimator:
        asked.extend([part, config, workspace])
        return ESTIMATOR

    monkeypatch.setattr(SegmentationPredictor, "for_part", for_part)
    monkeypatch.setattr(module, "PoseEstimator", estimator)
    made = Pipeline.for_part(ELL, BIN)
    assert asked == [ELL, ELL, None, BIN]
    assert (made.predictor, made.estimator, made.workspace) == (PREDICTOR, ESTIMATOR, BIN)
    assert made.boundary == BoundarySettings()
    assert_poses(made.perceive(FRAME))
    asked.clear()
    config, settings = EstimatorConfig(min_score=0.3), BoundarySettings(margin=0.004)
    made = Pipeline.for_part(ELL, BIN, boundary=settings, estimator=config)
    assert asked == [ELL, ELL, config, BIN]
    assert made.boundary == settings


def test_the_settings_of_the_boundary_are_used() -> None:
    settings = BoundarySettings(low=60.0, high=200.0)
    expected = extract_boundary(FRAME, BIN, settings)
    assert 0 < len(expected) < len(SEEN.boundary)
    for seen in (
        Pipeline(PREDICTOR, ESTIMATOR, BIN, measure_bin=False, boundary=settings).perceive(FRAME),
        perceive_by(true_groups, ESTIMATOR, FRAME, BIN, settings),
    ):
        np.testing.assert_array_equal(seen.boundary.points_cam, expected.points_cam)


@pytest.mark.parametrize(("around", "threads"), [(None, 1), (3, 3)])
def test_it_computes_on_one_thread_unless_told_otherwise(around: int | None, threads: int) -> None:
    """With the bin measured or not, and by any segmentation."""
    before, seen = cv2.getNumThreads(), []

    def groups(boundary: BoundaryCloud) -> list[Instance]:
        seen.append(cv2.getNumThreads())
        return []

    cv2.setNumThreads(2)
    with use_threads(around):
        for measure_bin in (True, False):
            Pipeline(KnowingPredictor(groups), ESTIMATOR, BIN, measure_bin=measure_bin).perceive(FRAME)
        perceive_by(groups, ESTIMATOR, FRAME, BIN)
    assert seen == [threads] * 3
    assert cv2.getNumThreads() == 2
    cv2.setNumThreads(before)


def test_a_part_without_weights_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BINPICK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(weights, "SHIPPED", tmp_path)
    with pytest.raises(WeightsError, match="no segmentation weights for 'ell' and none for every part"):
        Pipeline.for_part(ELL, BIN)

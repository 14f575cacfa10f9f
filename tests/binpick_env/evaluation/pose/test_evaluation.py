"""An evaluation of poses can be resumed, and its records hold the results of the estimator."""

import logging
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from binpick_env.config import CameraConfig
from binpick_env.evaluation.pose import evaluation as pose_evaluation
from binpick_env.evaluation.pose import method as pose_method
from binpick_env.evaluation.pose.ablation import PoseAblationConfig, PoseRow, run_pose_ablation
from binpick_env.evaluation.pose.evaluation import PoseEvaluationConfig, evaluate_pose_scene, evaluate_poses
from binpick_env.evaluation.pose.method import PoseMethodConfig
from binpick_env.evaluation.pose.record import PoseRecord
from binpick_env.evaluation.pose.scene_score import load_pose_scores
from binpick_env.evaluation.segmentation.record import record_path
from binpick_env.jobs import process_map
from binpick_env.parts import load_part
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.boundary import BoundaryCloud
from perception.frame import Frame, Workspace
from perception.instance import Instance
from perception.part import PartModel
from perception.pose.estimator_config import EstimatorConfig
from perception.pose.model.surface_models import surface_model
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.verification.verification import Verdict
from perception.runtime.records import RecordError
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.scene import BoundaryScene
from perception.segmentation.weights import save_network
from tests.binpick_env.evaluation.pose.pose_records import record

SCENES = SceneConfig(part="tee", seed=31, num_parts=(4, 5), camera=CameraConfig(width=640, height=480))
VERDICT = Verdict(edge_score=0.1, explained=0.2, support=0.3, violation=0.4, measured=0.5, logit=0.7)


captured_scene = lru_cache(make_scene)  # nothing here changes a scene


def scene_of(index: int) -> BoundaryScene:
    return captured_scene(SCENES, index).scene


class TruthEstimator:
    """Estimator that returns the true poses of the first two scenes, and records its calls."""

    def __init__(self, part: PartModel, config: EstimatorConfig) -> None:
        self.config = config
        self.group_counts: list[int] = []
        self.surface = surface_model(part)
        self.scenes = {scene_of(index).boundary.pixels.tobytes(): scene_of(index) for index in range(2)}

    def estimate_groups(
        self, boundary: BoundaryCloud, instances: Sequence[Instance], frame: Frame
    ) -> list[PoseEstimate | None]:
        self.group_counts.append(len(instances))
        scene = self.scenes[boundary.pixels.tobytes()]
        assert frame.depth.shape == (480, 640)
        found: list[PoseEstimate | None] = []
        for k, instance in enumerate(instances):
            owner = int(np.bincount(scene.instance_ids[instance.point_idx] + 1).argmax()) - 1
            found.append(self.true_estimate(scene, owner, k) if owner >= 0 else None)
        return found

    def estimate_leftovers(
        self,
        boundary: BoundaryCloud,
        instances: Sequence[Instance],
        estimates: Sequence[PoseEstimate | None],
        frame: Frame,
    ) -> tuple[list[Instance], list[PoseEstimate | None]]:
        return [], []

    def verified(self, estimates: Iterable[PoseEstimate | None]) -> list[PoseEstimate]:
        return [each for each in estimates if each is not None and each.score >= self.config.min_score][::-1]

    def estimate_scene(self, boundary: BoundaryCloud, frame: Frame) -> list[PoseEstimate]:
        scene = self.scenes[boundary.pixels.tobytes()]
        return [self.true_estimate(scene, owner, -1) for owner in range(len(scene.T_cam_parts))]

    def true_estimate(self, scene: BoundaryScene, owner: int, k: int) -> PoseEstimate:
        """Score the first part low."""
        return PoseEstimate(
            T_cam_part=scene.T_cam_parts[owner],
            score=0.95 if owner else 0.2,
            instance_idx=k,
            visible_fraction=0.6,
            verdict=VERDICT,
            margin=1.0,
            score_drop=2.0,
            size=50,
            surface_score=1.0,
        )


@pytest.fixture
def truth_estimators(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[TruthEstimator]]:
    """Replace every estimator by one that returns true poses; the list holds them."""
    made: list[TruthEstimator] = []

    def make(part: PartModel, config: EstimatorConfig, workspace: Workspace) -> TruthEstimator:
        assert workspace.inner_size.tolist() == [0.36, 0.26, 0.12]
        made.append(TruthEstimator(part, config))
        return made[-1]

    monkeypatch.setattr(pose_method, "make_estimator", make)
    monkeypatch.setattr(pose_evaluation, "whole_part_points", lambda *_: 400.0)
    monkeypatch.setattr(pose_evaluation, "make_scene", captured_scene)
    pose_method._loaded.cache_clear()
    yield made
    pose_method._loaded.cache_clear()


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    network = GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4))
    seen = [{"part": "tee", "seed": 5}, {"part": "bracket", "seed": 31}]
    save_network(path, network, {"parts": ["tee"], "trained_on": seen, "validated_on": [{"part": "tee", "seed": 6}]})
    return path


def config(**method: Any) -> PoseEvaluationConfig:
    return PoseEvaluationConfig(scenes=SCENES, method=PoseMethodConfig(**method))


# --- what is kept ----------------------------------------------------------------------------------------------------


def test_a_record_has_the_pose_of_each_group_and_the_truth(truth_estimators: list[TruthEstimator]) -> None:
    scene = scene_of(0)
    kept = evaluate_pose_scene(config(), 0)
    sizes = np.bincount(scene.instance_ids + 1)[1:]
    groups = np.flatnonzero(sizes >= 90)
    assert kept.sizes().tolist() == sizes[groups].tolist()
    owners, purities = kept.owners()
    assert owners.tolist() == groups.tolist()
    assert (purities == 1.0).all()
    np.testing.assert_array_equal(kept.poses, scene.T_cam_parts[groups])
    assert kept.groups.tolist() == list(range(len(groups)))
    assert kept.verified.tolist() == [owner > 0 for owner in groups]
    np.testing.assert_array_equal(kept.verdicts, np.tile([0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 2.0, 50.0], (len(groups), 1)))
    np.testing.assert_array_equal(kept.estimated_fractions, np.full(len(groups), 0.6))
    np.testing.assert_array_equal(kept.T_cam_parts, scene.T_cam_parts)
    np.testing.assert_array_equal(kept.pixels, scene.boundary.pixels)
    assert kept.picture.shape[0] > 200
    expected = round(400.0 / np.median(scene.boundary.points_cam[:, 2]))
    assert kept.trials.tolist() == np.argsort(np.abs(kept.sizes() - expected), kind="stable")[:3].tolist()
    assert not kept.whole_scene


def test_a_pose_in_what_is_left_over_counts_for_no_trial(
    truth_estimators: list[TruthEstimator], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its group is -1: a trial asks for the pose of its whole group."""
    plain = evaluate_pose_scene(config(), 0)

    def leftovers(
        self: TruthEstimator, boundary: BoundaryCloud, instances: list[Instance], *_: object
    ) -> tuple[list[Instance], list[PoseEstimate]]:
        return instances[:1], [self.true_estimate(scene_of(0), 1, len(instances))]

    monkeypatch.setattr(TruthEstimator, "estimate_leftovers", leftovers)
    kept = evaluate_pose_scene(config(), 0)
    assert kept.groups.tolist() == [*plain.groups.tolist(), -1]
    assert kept.verified.tolist() == [*plain.verified.tolist(), True]
    assert kept.trials.tolist() == plain.trials.tolist()
    np.testing.assert_array_equal(kept.poses[-1], scene_of(0).T_cam_parts[1])


def test_true_segments_need_enough_points(truth_estimators: list[TruthEstimator]) -> None:
    sizes = np.sort(np.bincount(scene_of(0).instance_ids + 1)[1:])
    kept = evaluate_pose_scene(config(min_points=int(sizes[-2])), 0, picture=False)
    assert sorted(kept.sizes()) == sizes[-2:].tolist()
    assert kept.picture.size == 0


def test_times_are_measured_after_a_warm_up(
    truth_estimators: list[TruthEstimator], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = torch.get_num_threads()
    first = evaluate_pose_scene(config(), 0)
    (estimator,) = truth_estimators
    groups = len(first.confidences)
    # One warm-up; each time the groups of the trials are estimated once more, alone.
    assert estimator.group_counts == [groups, 3] * 2
    evaluate_pose_scene(config(), 1)
    assert len(estimator.group_counts) == 6
    assert torch.get_num_threads() == before
    assert first.ms["total"] == pytest.approx(sum(first.ms[name] for name in ("boundary", "pose")))
    assert (first.ms["surface"], first.ms["segmentation"]) == (0.0, 0.0)
    assert min(first.ms[name] for name in ("boundary", "pose", "trials", "explanation")) > 0


def test_the_whole_scene_is_searched_without_segments(truth_estimators: list[TruthEstimator]) -> None:
    kept = evaluate_pose_scene(config(perception="whole_scene"), 0)
    (estimator,) = truth_estimators
    assert estimator.group_counts == []
    assert kept.whole_scene
    assert (kept.groups == -1).all()
    assert kept.segmentation(explained=True).matches().correct.any()  # parts are told apart by their poses alone
    assert kept.verified.all()
    assert np.isnan(kept.ms["trials"])
    assert kept.trials.tolist() == evaluate_pose_scene(config(), 0).trials.tolist()  # the same parts are asked for


def test_learned_segments_are_the_networks(
    truth_estimators: list[TruthEstimator], weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = [Instance(point_idx=np.arange(40, 200), score=0.8), Instance(point_idx=np.arange(300, 420), score=0.4)]
    monkeypatch.setattr(SegmentationPredictor, "predict", lambda *_: said)
    kept = evaluate_pose_scene(config(perception="learned", weights=weights), 0)
    assert kept.confidences.tolist() == [0.8, 0.4]
    assert [np.flatnonzero(kept.labels == k).tolist() for k in range(2)] == [s.point_idx.tolist() for s in said]
    assert kept.explained.max() == len(kept.explained_confidences) - 1
    assert (kept.explained >= 0).sum() > (kept.labels >= 0).sum()  # two poses explain more than two groups hold
    assert kept.ms["segmentation"] > 0
    assert kept.ms["surface"] > 0
    monkeypatch.setattr(SegmentationPredictor, "predict", lambda *_: [])
    nothing = evaluate_pose_scene(config(perception="learned", weights=weights), 0)
    assert (len(nothing.trials), len(nothing.poses)) == (0, 0)
    assert np.isnan(nothing.ms["trials"])


def test_a_method_is_cached_until_its_weights_change(
    tmp_path: Path, truth_estimators: list[TruthEstimator], weights: Path
) -> None:
    path = tmp_path / "w.safetensors"
    for suffix in (".safetensors", ".json"):
        path.with_suffix(suffix).write_bytes(weights.with_suffix(suffix).read_bytes())
    evaluation = config(perception="learned", weights=path)
    first = evaluation.load()
    assert evaluation.load() is first
    torch.manual_seed(1)
    save_network(path, GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4)), {})
    assert evaluation.load() is not first


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"perception": "magic"}, "perception must be one of learned, gt_masks, whole_scene, got 'magic'"),
        ({"perception": "learned"}, "weights are for perception 'learned' alone, got 'learned' and None"),
        ({"weights": Path("w")}, "weights are for perception 'learned' alone, got 'gt_masks' and w"),
        ({"min_points": 0}, "min_points must be at least 1, got 0"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        PoseMethodConfig(**changes)


# --- files -----------------------------------------------------------------------------------------------------------


def test_a_record_is_read_as_it_was_written(tmp_path: Path, truth_estimators: list[TruthEstimator]) -> None:
    kept = evaluate_pose_scene(config(), 0)
    kept.save(tmp_path / "r.npz")
    back = PoseRecord.load(tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz") as stored:  # the name in the file is that of earlier versions
        np.testing.assert_array_equal(stored["seen"], kept.estimated_fractions)
    for name, value in vars(kept).items():
        np.testing.assert_array_equal(getattr(back, name), value)
        assert np.asarray(getattr(back, name)).dtype == np.asarray(value).dtype
    with np.load(tmp_path / "r.npz") as stored:
        np.savez(tmp_path / "new.npz", **{**stored, "version": 99})
    with pytest.raises(RecordError, match=r"new\.npz is a pose record of version 99, this code reads 2"):
        PoseRecord.load(tmp_path / "new.npz")
    for name in ("labels", "trials", "groups"):
        with pytest.raises(ValueError, match=f"{name} go up to 7, but there are 4 groups"):
            record(**{name: np.full_like(getattr(record(), name), 7)})
    with pytest.raises(ValueError, match="explained go up to 3, but there are 2 groups"):
        record(explained_confidences=np.ones(2))
    with pytest.raises(
        ValueError, match="ms must have boundary, surface, segmentation, pose, trials, explanation, total, got"
    ):
        record(ms={"pose": 1.0})


def test_a_run_is_resumed_and_damaged_records_are_computed_again(
    tmp_path: Path, truth_estimators: list[TruthEstimator], caplog: pytest.LogCaptureFixture
) -> None:
    assert list(evaluate_poses(config(), 2, tmp_path)) == [0, 1]
    kept = record_path(tmp_path, 0).stat().st_mtime_ns
    whole = record_path(tmp_path, 1).read_bytes()
    record_path(tmp_path, 1).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordError, match=r"scene_00001\.npz does not hold a complete pose record"):
        load_pose_scores(tmp_path, 2, load_part("tee").model)
    with caplog.at_level(logging.WARNING):
        assert list(evaluate_poses(config(), 2, tmp_path)) == [0, 1]
    assert "evaluated again: " in caplog.text
    assert record_path(tmp_path, 0).stat().st_mtime_ns == kept
    scores = load_pose_scores(tmp_path, 2, load_part("tee").model)
    assert [score.index for score in scores] == [0, 1]
    assert all(score.trials.recognised.all() and score.all_poses.correct.all() for score in scores)
    list(evaluate_poses(config(), 1, tmp_path, fresh=True))
    assert record_path(tmp_path, 0).stat().st_mtime_ns > kept


def test_a_folder_of_another_evaluation_is_refused_and_the_difference_named(
    tmp_path: Path, truth_estimators: list[TruthEstimator]
) -> None:
    list(evaluate_poses(config(), 1, tmp_path))
    other = replace(EstimatorConfig(), min_score=0.25)
    text = r"another configuration \(method\.estimator\.min_score: 0\.9 there, 0\.25 here\); choose another folder"
    with pytest.raises(ValueError, match=text):
        next(evaluate_poses(config(estimator=other), 1, tmp_path))
    with pytest.raises(ValueError, match=r"\(seed: 31 there, 8 here\)"):
        next(evaluate_poses(replace(config(), scenes=replace(SCENES, seed=8)), 1, tmp_path))


def test_scenes_of_the_training_are_refused(
    tmp_path: Path, truth_estimators: list[TruthEstimator], weights: Path
) -> None:
    mine = config(perception="learned", weights=weights)
    for seed, use in ((5, "trained on"), (6, "validated on")):
        with pytest.raises(ValueError, match=rf"has been {use} scenes of seed {seed}; evaluate it with another seed"):
            next(evaluate_poses(replace(mine, scenes=replace(SCENES, seed=seed)), 1, tmp_path / "out"))
    assert not (tmp_path / "out").exists()
    assert next(evaluate_poses(mine, 1, tmp_path / "out")) == 0  # seed 31 was another part's


def test_an_invalid_evaluation_leaves_no_folder(tmp_path: Path, truth_estimators: list[TruthEstimator]) -> None:
    out = tmp_path / "out"
    with pytest.raises(ValueError, match="part must be one of"):
        next(evaluate_poses(replace(config(), scenes=replace(SCENES, part="teapot")), 1, out))
    with pytest.raises(ValueError, match="count and workers must be at least 1, got 0 and 1"):
        next(evaluate_poses(config(), 0, out))
    with pytest.raises(FileNotFoundError, match=r"none\.safetensors"):
        next(evaluate_poses(config(perception="learned", weights=tmp_path / "none.safetensors"), 1, out))
    assert not out.exists()


@pytest.mark.slow
def test_the_records_do_not_depend_on_the_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a process of its own, which makes the scenes, too; the evaluation of segments starts its own likewise."""
    # One of the two processes does both; test_process_map.py starts several.
    monkeypatch.setattr(process_map, "ProcessPoolExecutor", lambda _, **how: ProcessPoolExecutor(1, **how))
    small = replace(config(), scenes=replace(SCENES, num_parts=(1, 1)))
    list(evaluate_poses(small, 2, tmp_path / "1", 1, pictures=False))
    list(evaluate_poses(small, 2, tmp_path / "2", 2, pictures=False))
    for index in range(2):
        one, two = (PoseRecord.load(record_path(tmp_path / name, index)) for name in "12")
        assert len(one.poses) == 1
        for name in (
            "labels", "trials", "poses", "scores", "groups", "verified", "verdicts",
            "instance_ids", "visible_fractions", "T_cam_parts", "pixels",
        ):  # fmt: skip
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        assert two.threads == 1


# --- ablation --------------------------------------------------------------------------------------------------------


def test_rows_of_the_same_key_are_evaluated_once_and_resumed(
    tmp_path: Path, truth_estimators: list[TruthEstimator]
) -> None:
    other = PoseMethodConfig(estimator=replace(EstimatorConfig(), min_score=0.0))
    rows = [
        PoseRow(key="full", name="full", method=PoseMethodConfig()),
        PoseRow(key="full", name="all", method=PoseMethodConfig(), verified=False),
        PoseRow(key="lenient", name="lenient", method=other),
    ]
    said: list[str] = []
    ablation = PoseAblationConfig(scenes=SCENES, count=2, rows=rows)
    table = run_pose_ablation(ablation, tmp_path, report=said.append)
    assert said == [f"{name}: scene {k} of 2" for name in ("full", "lenient") for k in (1, 2)]
    full, everything, lenient = table.rows
    assert full.delivered < everything.delivered == lenient.delivered
    assert (full.precision, full.recognition_rate, full.trials) == (1.0, 1.0, 6)
    asked = sum(len(estimator.group_counts) for estimator in truth_estimators)
    assert run_pose_ablation(ablation, tmp_path).rows == table.rows
    assert sum(len(estimator.group_counts) for estimator in truth_estimators) == asked
    with pytest.raises(ValueError, match="holds an ablation of poses of another configuration"):
        run_pose_ablation(replace(ablation, scenes=replace(SCENES, seed=8)), tmp_path)

"""The truth scores 1 and no prediction 0; an interrupted evaluation is resumed, another's folder refused."""

import logging
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from binpick_env.evaluation.segmentation import evaluation
from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig, evaluate_scene, evaluate_scenes
from binpick_env.evaluation.segmentation.method import MethodConfig, Segmenter
from binpick_env.evaluation.segmentation.record import STAGES, SceneRecord, record_path
from binpick_env.evaluation.segmentation.summary import BANDS, load_scores
from binpick_env.scenes.synthesis import make_scene
from perception.boundary import BoundaryCloud
from perception.geometry import Floats
from perception.instance import Instance, instances_of
from perception.runtime.records import RecordError
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.surface import Surface
from perception.segmentation.weights import WeightsError, save_network
from tests.binpick_env.evaluation.segmentation.small_evaluation import SCENES, summary_of, tiny_grid
from tests.binpick_env.jobs.pickled_map import pickled_map

captured_scene = lru_cache(make_scene)  # nothing here changes a scene


@pytest.fixture(autouse=True)
def _scenes_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation, "make_scene", captured_scene)


def predict_instead(monkeypatch: pytest.MonkeyPatch, answer: Any) -> None:
    """Replace the predictions of each scene by ``answer(ids)`` of its true ids."""
    truths = {}
    for index in range(3):
        scene = captured_scene(SCENES, index).scene
        truths[scene.boundary.pixels.tobytes()] = scene.instance_ids

    def predict(
        _: object, boundary: BoundaryCloud, surface: Surface, d_max: float, shape: Floats | None
    ) -> list[Instance]:
        assert surface.depth.max() > 0
        assert shape is not None
        assert 0.05 < d_max < 0.11
        found: list[Instance] = answer(truths[boundary.pixels.tobytes()])
        return found

    monkeypatch.setattr(SegmentationPredictor, "predict", predict)


def perfect(ids: np.ndarray) -> list[Instance]:
    return instances_of(ids, np.full(ids.max() + 1, 0.5))


# --- numbers ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_truth_scores_one_and_nothing_scores_zero(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, config: EvaluationConfig
) -> None:
    predict_instead(monkeypatch, perfect)
    list(evaluate_scenes(config, 3, tmp_path / "truth"))
    summary = summary_of(config, tmp_path / "truth", 3)
    assert (summary.ap, summary.ap50, summary.ap75, summary.ap25) == (1.0, 1.0, 1.0, 1.0)
    assert set(summary.intervals.values()) == {(1.0, 1.0)}
    parts = [band.parts for band in summary.by_visible_fraction]
    assert sum(parts) >= 6
    for band in summary.by_visible_fraction:
        assert (band.ap, band.found75) == ((1.0, 1.0) if band.parts else (pytest.approx(np.nan, nan_ok=True),) * 2)
    predict_instead(monkeypatch, lambda _: [])
    list(evaluate_scenes(config, 3, tmp_path / "nothing"))
    nothing = summary_of(config, tmp_path / "nothing", 3)
    assert (nothing.ap, nothing.ap50, nothing.ap25) == (0.0, 0.0, 0.0)
    assert [band.parts for band in nothing.by_visible_fraction] == parts
    assert {band.found50 for band in nothing.by_visible_fraction if band.parts} == {0.0}


def test_two_merged_parts_lower_the_ap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, config: EvaluationConfig
) -> None:
    predict_instead(monkeypatch, lambda ids: perfect(np.where(ids == 1, 0, ids)))
    list(evaluate_scenes(config, 3, tmp_path))
    assert summary_of(config, tmp_path, 3).ap < 0.9


@pytest.mark.slow
def test_each_counted_part_is_in_one_band(tmp_path: Path, config: EvaluationConfig) -> None:
    list(evaluate_scenes(config, 3, tmp_path))
    assert [high for _, high in BANDS[:-1]] == [low for low, _ in BANDS[1:]]
    scores = load_scores(tmp_path, 3)
    whole = sum(sum(score.matches.truth_counts.values()) for score in scores)
    assert sum(band.parts for band in summary_of(config, tmp_path, 3).by_visible_fraction) == whole
    for score in scores:
        record = SceneRecord.load(record_path(tmp_path, score.index))
        counted = (record.visible_fractions >= 0.1) & (np.bincount(record.instance_ids + 1)[1:] >= 100)
        assert sum(score.matches.truth_counts.values()) == counted.sum()
        assert score.clutter.median == np.median(captured_scene(SCENES, score.index).scene.visible_fractions)


def test_a_scenes_time_is_the_sum_of_its_stages_after_a_warm_up(config: EvaluationConfig) -> None:
    calls: list[int] = []
    method = Segmenter(config.method)
    segment = method.segment
    method.segment = lambda *args: (calls.append(1), segment(*args))[1]  # type: ignore[method-assign]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "segmenter", lambda _: method)
        before = torch.get_num_threads()
        first = evaluate_scene(config, 0)
        assert len(calls) == 2  # once to warm up
        evaluate_scene(config, 1)
        assert len(calls) == 3
        assert torch.get_num_threads() == before
    assert first.ms["total"] == pytest.approx(sum(first.ms[name] for name in STAGES[:-1]))
    assert min(first.ms.values()) > 0


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_is_resumed_and_damaged_records_are_computed_again(
    tmp_path: Path, config: EvaluationConfig, caplog: pytest.LogCaptureFixture
) -> None:
    assert list(evaluate_scenes(config, 2, tmp_path)) == [0, 1]
    kept = record_path(tmp_path, 0).stat().st_mtime_ns
    whole = record_path(tmp_path, 1).read_bytes()
    record_path(tmp_path, 1).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordError, match=r"scene_00001\.npz does not hold a complete segmentation record"):
        load_scores(tmp_path, 2)
    with caplog.at_level(logging.WARNING):
        assert sorted(evaluate_scenes(config, 2, tmp_path)) == [0, 1]
    assert "evaluated again: " in caplog.text
    assert record_path(tmp_path, 0).stat().st_mtime_ns == kept
    again = SceneRecord.load(record_path(tmp_path, 1))
    record_path(tmp_path, 1).write_bytes(whole)
    np.testing.assert_array_equal(again.labels, SceneRecord.load(record_path(tmp_path, 1)).labels)
    list(evaluate_scenes(config, 1, tmp_path, fresh=True))
    assert record_path(tmp_path, 0).stat().st_mtime_ns > kept


@pytest.mark.slow
def test_the_records_do_not_depend_on_the_workers(
    tmp_path: Path, config: EvaluationConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes are started in the evaluation of poses."""
    list(evaluate_scenes(config, 2, tmp_path / "1", 1, pictures=False))
    monkeypatch.setattr(evaluation, "map_indices", pickled_map)
    assert list(evaluate_scenes(config, 2, tmp_path / "2", 2)) == [1, 0]
    for index in range(2):
        one, two = (SceneRecord.load(record_path(tmp_path / name, index)) for name in "12")
        np.testing.assert_array_equal(one.instance_ids, two.instance_ids)
        np.testing.assert_array_equal(one.pixels, two.pixels)
        assert (one.labels == two.labels).mean() > 0.99  # sums over threads may round otherwise
        assert one.picture.size == 0
        assert two.picture.shape[0] > 200
        assert two.threads == 1


def test_a_record_is_read_as_it_was_written(tmp_path: Path, config: EvaluationConfig) -> None:
    record = evaluate_scene(config, 0)
    record.save(tmp_path / "r.npz")
    back = SceneRecord.load(tmp_path / "r.npz")
    for name in ("labels", "scores", "instance_ids", "visible_fractions", "pixels", "picture"):
        np.testing.assert_array_equal(getattr(back, name), getattr(record, name))
        assert getattr(back, name).dtype == getattr(record, name).dtype
    assert (back.ms, back.corner, back.threads) == (record.ms, record.corner, record.threads)
    assert [i.point_idx.tolist() for i in back.instances()] == [
        np.flatnonzero(record.labels == k).tolist() for k in range(len(record.scores))
    ]
    with np.load(tmp_path / "r.npz") as stored:
        np.savez(tmp_path / "new.npz", **{**stored, "version": 99})
    with pytest.raises(RecordError, match=r"new\.npz is a segmentation record of version 99, this code reads 1"):
        SceneRecord.load(tmp_path / "new.npz")
    with pytest.raises(ValueError, match=r"labels go up to 5, but there are 1 scores"):
        replace(record, labels=np.full_like(record.labels, 5), scores=np.ones(1))
    with pytest.raises(ValueError, match="ms must have boundary, surface, segmentation, total, got total"):
        replace(record, ms={"total": 1.0})


@pytest.mark.slow
def test_a_folder_of_another_evaluation_is_refused(tmp_path: Path, config: EvaluationConfig, weights: Path) -> None:
    list(evaluate_scenes(config, 1, tmp_path))
    copy = tmp_path / "copy.safetensors"
    for suffix in (".safetensors", ".json"):
        copy.with_suffix(suffix).write_bytes(weights.with_suffix(suffix).read_bytes())
    list(evaluate_scenes(replace(config, method=MethodConfig(weights=copy)), 1, tmp_path))  # the same by content
    other = replace(config, scenes=replace(SCENES, seed=8))
    text = r"holds an evaluation of another configuration \(seed: 7 there, 8 here\); choose another folder with --out"
    with pytest.raises(ValueError, match=text):
        next(evaluate_scenes(other, 1, tmp_path))
    with pytest.raises(ValueError, match=r"another configuration \(method: .*'threshold': 3.0"):
        next(evaluate_scenes(replace(config, method=config.method.with_grouping_distance(3.0)), 1, tmp_path))


def test_an_invalid_evaluation_leaves_no_folder(tmp_path: Path, config: EvaluationConfig) -> None:
    out = tmp_path / "out"
    lost = MethodConfig(weights=tmp_path / "none.safetensors")
    for wrong, error, text in (
        (replace(config, scenes=replace(SCENES, part="teapot")), ValueError, "part must be one of"),
        (replace(config, method=lost), FileNotFoundError, r"none\.safetensors"),
    ):
        with pytest.raises(error, match=text):
            next(evaluate_scenes(wrong, 1, out))
    (tmp_path / "none.safetensors").write_bytes(b"nothing")
    with pytest.raises(WeightsError, match=r"none\.safetensors does not hold a complete segmentation network"):
        next(evaluate_scenes(replace(config, method=lost), 1, out))
    with pytest.raises(ValueError, match="count and workers must be at least 1, got 0 and 1"):
        next(evaluate_scenes(config, 0, out))
    assert not out.exists()


@pytest.mark.parametrize("use", ["trained_on", "validated_on"])
def test_scenes_of_the_training_are_refused(use: str, tmp_path: Path) -> None:
    path = tmp_path / "seen.safetensors"
    save_network(path, tiny_grid(), {use: [{"part": "bracket", "seed": 7}, {"part": "tee", "seed": 8}]})
    seen = EvaluationConfig(scenes=replace(SCENES, seed=8), method=MethodConfig(weights=path))
    with pytest.raises(
        ValueError, match=rf"has been {use.replace('_', ' ')} scenes of seed 8; evaluate it with another"
    ):
        list(evaluate_scenes(seen, 1, tmp_path / "out"))
    assert not (tmp_path / "out").exists()

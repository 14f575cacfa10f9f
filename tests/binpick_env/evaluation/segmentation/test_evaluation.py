"""A segmentation is judged as it is: the truth scores 1, nothing scores 0; a run can be stopped and gone on with."""

import json
import logging
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from binpick_env.config import CameraConfig
from binpick_env.evaluation.segmentation import evaluation
from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig, evaluate_scene, evaluate_scenes
from binpick_env.evaluation.segmentation.method import MethodConfig, Segmenter, segmenter, trained_distance
from binpick_env.evaluation.segmentation.record import STAGES, RecordError, SceneRecord, record_path
from binpick_env.evaluation.segmentation.report import worst_first, write_report
from binpick_env.evaluation.segmentation.summary import BANDS, SegmentationSummary, load_scores, save_summary, summarise
from binpick_env.evaluation.segmentation.table import segmentation_table
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.boundary import BoundaryCloud
from perception.instance import Instance, instances_of, labels_of
from perception.segmentation.networks.grid_net import GridNet, GridNetConfig
from perception.segmentation.networks.sgpn import Sgpn, SgpnConfig
from perception.segmentation.predictor import SegmentationPredictor
from perception.segmentation.surface import Surface
from perception.segmentation.weights import WeightsError, save_network

SCENES = SceneConfig(part="tee", seed=7, num_parts=(3, 4), camera=CameraConfig(width=640, height=480))


def tiny_grid() -> GridNet:
    torch.manual_seed(0)
    return GridNet(GridNetConfig(widths=(4, 4, 4, 4, 4), hidden=8, embedding=4))


def tiny_sgpn() -> Sgpn:
    torch.manual_seed(0)
    return Sgpn(SgpnConfig(trunk="pointnet", embedding=8, branch=8, global_width=16))


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_network(path, tiny_grid(), {"parts": ["tee"], "git_commit": "abc", "steps": 0})
    return path


@pytest.fixture(scope="module")
def sgpn_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "sgpn.safetensors"
    save_network(path, tiny_sgpn(), {"training": {"pairs": {"distance": "scaled_square"}}})
    return path


@pytest.fixture
def config(weights: Path) -> EvaluationConfig:
    return EvaluationConfig(scenes=SCENES, method=MethodConfig(weights=weights))


def summary_of(config: EvaluationConfig, folder: Path, count: int) -> SegmentationSummary:
    return summarise(config, load_scores(folder, count), np.random.default_rng(0), resamples=50)


def predict_instead(monkeypatch: pytest.MonkeyPatch, answer: Any) -> None:
    """Let ``answer(ids)`` of each scene's true ids be what the predictor says."""
    truths = {}
    for index in range(3):
        scene = make_scene(SCENES, index).scene
        truths[scene.boundary.pixels.tobytes()] = scene.instance_ids

    def predict(_: object, boundary: BoundaryCloud, surface: Surface, d_max: float) -> list[Instance]:
        assert surface.depth.max() > 0
        assert 0.05 < d_max < 0.11
        found: list[Instance] = answer(truths[boundary.pixels.tobytes()])
        return found

    monkeypatch.setattr(SegmentationPredictor, "predict", predict)


def perfect(ids: np.ndarray) -> list[Instance]:
    return instances_of(ids, np.full(ids.max() + 1, 0.5))


# --- numbers ---------------------------------------------------------------------------------------------------------


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


def test_one_part_taken_for_another_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, config: EvaluationConfig
) -> None:
    predict_instead(monkeypatch, lambda ids: perfect(np.where(ids == 1, 0, ids)))
    list(evaluate_scenes(config, 3, tmp_path))
    assert summary_of(config, tmp_path, 3).ap < 0.9


def test_bands_share_the_counted_parts_out(tmp_path: Path, config: EvaluationConfig) -> None:
    list(evaluate_scenes(config, 3, tmp_path))
    assert [high for _, high in BANDS[:-1]] == [low for low, _ in BANDS[1:]]
    scores = load_scores(tmp_path, 3)
    whole = sum(sum(score.matches.truth_counts.values()) for score in scores)
    assert sum(band.parts for band in summary_of(config, tmp_path, 3).by_visible_fraction) == whole
    for score in scores:
        record = SceneRecord.load(record_path(tmp_path, score.index))
        counted = (record.visible_fractions >= 0.1) & (np.bincount(record.instance_ids + 1)[1:] >= 100)
        assert sum(score.matches.truth_counts.values()) == counted.sum()
        assert score.clutter.median == np.median(make_scene(SCENES, score.index).scene.visible_fractions)


def test_a_scenes_time_is_that_of_its_stages_after_a_first_run(config: EvaluationConfig) -> None:
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


# --- methods ---------------------------------------------------------------------------------------------------------


def test_every_method_labels_the_same_points(weights: Path, sgpn_weights: Path) -> None:
    scene = make_scene(SCENES, 0).scene
    methods = [
        MethodConfig(weights=weights),
        MethodConfig(weights=weights, mask=False, threshold=100.0),
        MethodConfig(weights=sgpn_weights, subset=500),
        MethodConfig(weights=sgpn_weights, grouping="merging", subset=500, threshold=1.0),
        MethodConfig(kind="euclidean", radius=0.004),
    ]
    for method in methods:
        instances = Segmenter(method).segment(scene.boundary, scene.surface, scene.d_max)
        labels = labels_of(instances, len(scene.boundary))
        np.testing.assert_array_equal(np.unique(labels[labels >= 0]), np.arange(len(instances)))
        assert min((i.score for i in instances), default=0.0) >= 0
        assert Segmenter(method).segment(_nothing(), scene.surface, scene.d_max) == []


def test_the_distance_mask_is_what_it_says(weights: Path, sgpn_weights: Path) -> None:
    scene = make_scene(SCENES, 0).scene

    def widest(method: MethodConfig) -> float:
        instances = Segmenter(method).segment(scene.boundary, scene.surface, scene.d_max)
        points = [scene.boundary.points_cam[i.point_idx] for i in instances]
        return max(float(np.linalg.norm(p - p[0], axis=1).max()) for p in points) / scene.d_max

    for file, grouping in ((weights, "ours"), (sgpn_weights, "ours")):
        loose = MethodConfig(weights=file, grouping=grouping, mask=False, threshold=1e6)  # type: ignore[arg-type]
        assert widest(loose) > 1.2
        assert widest(replace(loose, mask=True)) < 1.05


def test_settings_are_tried_at_once(weights: Path) -> None:
    scene = make_scene(SCENES, 0).scene
    for method, settings in (
        (MethodConfig(weights=weights), (1.0, 7.5)),
        (MethodConfig(kind="euclidean"), (0.002, 0.01)),
    ):
        together = Segmenter(method).segment_at(settings, scene.boundary, scene.surface, scene.d_max)
        for setting, instances in zip(settings, together, strict=True):
            assert method.at(setting).setting == setting
            alone = Segmenter(method.at(setting)).segment(scene.boundary, scene.surface, scene.d_max)
            assert [i.point_idx.tolist() for i in alone] == [i.point_idx.tolist() for i in instances]
    assert MethodConfig(weights=weights).setting == 9.0


def test_a_network_is_kept_until_its_weights_change(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_network(path, tiny_grid(), {})
    method = MethodConfig(weights=path)
    first = segmenter(method)
    assert segmenter(method) is first
    other = tiny_grid()
    torch.nn.init.zeros_(other.offset.weight)
    save_network(path, other, {})
    assert segmenter(method) is not first


def test_the_embeddings_distance_is_that_of_the_training() -> None:
    assert trained_distance({"training": {"pairs": {"distance": "scaled_square"}}}) == "scaled_square"
    assert trained_distance({}) == trained_distance({"training": {"pairs": {"distance": "l2"}}}) == "l2"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"kind": "magic"}, "kind must be one of network, euclidean, got 'magic'"),
        ({"grouping": "magic"}, "grouping must be one of ours, merging, got 'magic'"),
        ({}, "kind 'network' needs weights, got None"),
        ({"kind": "euclidean", "radius": 0.0}, "radius must be positive, got 0.0"),
        ({"kind": "euclidean", "threshold": -1.0}, "threshold must be positive, got -1.0"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        MethodConfig(**changes)


# --- files -----------------------------------------------------------------------------------------------------------


def test_a_run_goes_on_and_damaged_records_are_made_again(
    tmp_path: Path, config: EvaluationConfig, caplog: pytest.LogCaptureFixture
) -> None:
    assert list(evaluate_scenes(config, 2, tmp_path)) == [0, 1]
    kept = record_path(tmp_path, 0).stat().st_mtime_ns
    whole = record_path(tmp_path, 1).read_bytes()
    record_path(tmp_path, 1).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordError, match=r"scene_00001\.npz holds no whole record"):
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
def test_the_records_do_not_depend_on_the_workers(tmp_path: Path, config: EvaluationConfig) -> None:
    list(evaluate_scenes(config, 2, tmp_path / "1", 1, pictures=False))
    list(evaluate_scenes(config, 2, tmp_path / "2", 2))
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
    with pytest.raises(RecordError, match=r"new\.npz is of version 99, this code reads 1"):
        SceneRecord.load(tmp_path / "new.npz")
    with pytest.raises(ValueError, match=r"labels go up to 5, but there are 1 scores"):
        replace(record, labels=np.full_like(record.labels, 5), scores=np.ones(1))
    with pytest.raises(ValueError, match="ms must have boundary, surface, segmentation, total, got total"):
        replace(record, ms={"total": 1.0})


def test_another_evaluations_folder_is_refused(tmp_path: Path, config: EvaluationConfig, weights: Path) -> None:
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
        next(evaluate_scenes(replace(config, method=config.method.at(3.0)), 1, tmp_path))


def test_what_cannot_be_done_claims_no_folder(tmp_path: Path, config: EvaluationConfig) -> None:
    out = tmp_path / "out"
    lost = MethodConfig(weights=tmp_path / "none.safetensors")
    for wrong, error, text in (
        (replace(config, scenes=replace(SCENES, part="teapot")), ValueError, "part must be one of"),
        (replace(config, method=lost), FileNotFoundError, r"none\.safetensors"),
    ):
        with pytest.raises(error, match=text):
            next(evaluate_scenes(wrong, 1, out))
    (tmp_path / "none.safetensors").write_bytes(b"nothing")
    with pytest.raises(WeightsError, match=r"none\.safetensors holds no network"):
        next(evaluate_scenes(replace(config, method=lost), 1, out))
    with pytest.raises(ValueError, match="count and workers must be at least 1, got 0 and 1"):
        next(evaluate_scenes(config, 0, out))
    assert not out.exists()


# --- for people ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> tuple[Path, EvaluationConfig]:
    folder = tmp_path_factory.mktemp("judged")
    config = EvaluationConfig(scenes=SCENES, method=MethodConfig(weights=weights))
    list(evaluate_scenes(config, 3, folder))
    return folder, config


@pytest.mark.parametrize("use", ["trained_on", "validated_on"])
def test_scenes_that_the_weights_have_seen_are_refused(use: str, tmp_path: Path) -> None:
    path = tmp_path / "seen.safetensors"
    save_network(path, tiny_grid(), {use: [{"part": "bracket", "seed": 7}, {"part": "tee", "seed": 8}]})
    seen = EvaluationConfig(scenes=replace(SCENES, seed=8), method=MethodConfig(weights=path))
    with pytest.raises(ValueError, match=rf"has been {use.replace('_', ' ')} scenes of seed 8; judge it with another"):
        list(evaluate_scenes(seen, 1, tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_the_numbers_have_the_keys_of_the_contract(judged: tuple[Path, EvaluationConfig]) -> None:
    folder, config = judged
    values = asdict(summary_of(config, folder, 3))
    assert {
        "ap", "ap50", "ap75", "ap25", "ms_per_scene", "intervals", "by_visible_fraction", "clutter", "ms", "scenes",
        "seed", "sensor", "part", "points_per_scene", "weights", "versions", "git_commits",
        "wrong_side", "wrong_side_at_contours",
    } <= set(values)  # fmt: skip
    assert set(values["intervals"]) == {"ap", "ap50", "ap75", "ap25"}
    assert set(values["ms"]) == set(STAGES)
    assert 0 <= values["wrong_side"] <= values["wrong_side_at_contours"] < 0.5
    assert values["ms_per_scene"] == values["ms"]["total"]
    assert {"median", "below_half", "above_nine_tenths"} <= set(values["clutter"])
    assert values["weights"]["git_commit"] == "abc"
    assert "torch" in values["versions"]


def test_the_table_says_where_its_numbers_come_from(judged: tuple[Path, EvaluationConfig]) -> None:
    folder, config = judged
    summary = summary_of(config, folder, 3)
    text = segmentation_table(summary)
    assert "tee · tiny.safetensors · sensor good · 3 scenes · seed 7" in text
    assert re.search(r"AP50 +[\d.]+ +[\d.]+ to [\d.]+ +50\.5", text)
    assert "hand-labelled real scenes" in text
    assert "0.9 to 1.0" in text
    assert max(map(len, text.split("\n"))) < 140
    assert "NOTE  scenes were evaluated by commit old" in segmentation_table(replace(summary, git_commits=["old"]))
    floor = replace(summary, weights=None, method=MethodConfig(kind="euclidean", radius=0.003).note())
    assert "components of radius 3 mm" in segmentation_table(floor)


def test_nothing_to_sum_up_is_refused(config: EvaluationConfig) -> None:
    with pytest.raises(ValueError, match="there is nothing to sum up: no scene was evaluated"):
        summarise(config, [], np.random.default_rng(0))


def test_the_report_shows_the_worst_scenes_first(tmp_path: Path, judged: tuple[Path, EvaluationConfig]) -> None:
    folder, config = judged
    scores = load_scores(folder, 3)
    scores = [replace(score, ap=ap) for score, ap in zip(scores, (0.9, np.nan, 0.2), strict=True)]
    assert [score.index for score in worst_first(scores)] == [2, 0, 1]
    write_report(tmp_path / "report.html", summary_of(config, folder, 3), scores, folder, gallery=2)
    text = (tmp_path / "report.html").read_text()
    assert re.findall(r"<h3>Scene (\d+)", text) == ["2", "0"]
    assert "2 of 3 scenes." in text
    assert text.count("data:image/jpeg") == 2
    assert text.count("data:image/png") == 6
    assert "<polyline class='line-1'" in text
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)


def test_an_empty_bin_is_judged_and_shown(tmp_path: Path, config: EvaluationConfig) -> None:
    empty = replace(config, scenes=replace(SCENES, num_parts=(0, 0)))
    list(evaluate_scenes(empty, 1, tmp_path))
    summary = summary_of(empty, tmp_path, 1)
    assert np.isnan([summary.ap, *summary.intervals["ap"]]).all()
    assert "–" in segmentation_table(summary)
    write_report(tmp_path / "report.html", summary, load_scores(tmp_path, 1), tmp_path, 5)
    assert "Scene 0" in (tmp_path / "report.html").read_text()


def test_settings_are_kept_as_json(tmp_path: Path, judged: tuple[Path, EvaluationConfig]) -> None:
    folder, config = judged
    save_summary(tmp_path / "n.json", summary_of(config, folder, 3))
    kept = json.loads((tmp_path / "n.json").read_text())
    assert kept["config"]["method"]["weights"] == kept["weights"]["sha256"] == config.method.digest()
    assert kept["config"]["num_parts"] == [3, 4]


def _nothing() -> BoundaryCloud:
    return BoundaryCloud(
        points_cam=np.zeros((0, 3)),
        tangents_cam=np.zeros((0, 3)),
        linearity=np.zeros(0),
        pixels=np.zeros((0, 2), np.int64),
    )

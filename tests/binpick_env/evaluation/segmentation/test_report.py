"""Summary, table and report of an evaluation: every number of the contract, with its source."""

import json
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from binpick_env.evaluation.segmentation.evaluation import EvaluationConfig, evaluate_scenes
from binpick_env.evaluation.segmentation.method import MethodConfig
from binpick_env.evaluation.segmentation.record import STAGES
from binpick_env.evaluation.segmentation.report import worst_first, write_report
from binpick_env.evaluation.segmentation.summary import load_scores, save_summary, summarise
from binpick_env.evaluation.segmentation.table import segmentation_table
from tests.binpick_env.evaluation.segmentation.small_evaluation import SCENES, summary_of


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory, weights: Path) -> tuple[Path, EvaluationConfig]:
    folder = tmp_path_factory.mktemp("evaluated")
    config = EvaluationConfig(scenes=SCENES, method=MethodConfig(weights=weights))
    list(evaluate_scenes(config, 3, folder))
    return folder, config


@pytest.mark.slow
def test_the_numbers_have_the_keys_of_the_contract(evaluated: tuple[Path, EvaluationConfig]) -> None:
    folder, config = evaluated
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


def test_the_table_says_where_its_numbers_come_from(evaluated: tuple[Path, EvaluationConfig]) -> None:
    folder, config = evaluated
    summary = summary_of(config, folder, 3)
    text = segmentation_table(summary)
    assert "tee · tiny.safetensors, own · sensor good · 3 scenes · seed 7" in text
    assert re.search(r"AP50 +[\d.]+ +[\d.]+ to [\d.]+ +50\.5", text)
    assert "hand-labelled real scenes" in text
    assert "0.9 to 1.0" in text
    assert max(map(len, text.split("\n"))) < 140
    assert "NOTE  scenes were evaluated by commit old" in segmentation_table(replace(summary, git_commits=["old"]))
    floor = replace(summary, weights=None, method=MethodConfig(kind="euclidean", radius=0.003).settings())
    assert "components of radius 3 mm" in segmentation_table(floor)


def test_nothing_to_sum_up_is_refused(config: EvaluationConfig) -> None:
    with pytest.raises(ValueError, match="there is nothing to sum up: no scene was evaluated"):
        summarise(config, [], np.random.default_rng(0))


def test_the_report_shows_the_worst_scenes_first(tmp_path: Path, evaluated: tuple[Path, EvaluationConfig]) -> None:
    folder, config = evaluated
    scores = load_scores(folder, 3)
    scores = [replace(score, ap=ap) for score, ap in zip(scores, (0.9, np.nan, 0.2), strict=True)]
    assert [score.index for score in worst_first(scores)] == [2, 0, 1]
    write_report(tmp_path / "report.html", summary_of(config, folder, 3), scores, folder, gallery=2)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert re.findall(r"<h3>Scene (\d+)", text) == ["2", "0"]
    assert "2 of 3 scenes." in text
    assert text.count("data:image/jpeg") == 2
    assert text.count("data:image/png") == 6
    assert "<polyline class='line-1'" in text
    assert not re.search(r"https?://|<script|<link|@import|url\(", text)


def test_an_empty_bin_is_evaluated_and_shown(tmp_path: Path, config: EvaluationConfig) -> None:
    empty = replace(config, scenes=replace(SCENES, num_parts=(0, 0)))
    list(evaluate_scenes(empty, 1, tmp_path))
    summary = summary_of(empty, tmp_path, 1)
    assert np.isnan([summary.ap, *summary.intervals["ap"]]).all()
    assert "–" in segmentation_table(summary)
    write_report(tmp_path / "report.html", summary, load_scores(tmp_path, 1), tmp_path, 5)
    assert "Scene 0" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_settings_are_kept_as_json(tmp_path: Path, evaluated: tuple[Path, EvaluationConfig]) -> None:
    folder, config = evaluated
    save_summary(tmp_path / "n.json", summary_of(config, folder, 3))
    kept = json.loads((tmp_path / "n.json").read_text(encoding="utf-8"))
    assert kept["config"]["method"]["weights"] == kept["weights"]["sha256"] == config.method.digest()
    assert kept["config"]["num_parts"] == [3, 4]

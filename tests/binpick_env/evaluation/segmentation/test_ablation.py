"""Each row is trained and evaluated once; intervals cover trainings and scenes."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from binpick_env.config import CameraConfig
from binpick_env.evaluation.segmentation import ablation, ablation_summary, ablation_table, evaluation
from binpick_env.evaluation.segmentation.ablation import BUDGET, ROWS, AblationConfig, run_ablation, trainings
from binpick_env.evaluation.segmentation.ablation_summary import METRICS, AblationTable, RowScores, tabulate
from binpick_env.evaluation.segmentation.record import STAGES
from binpick_env.evaluation.segmentation.summary import BANDS, SceneScore
from binpick_env.scenes.clutter import ClutterStats
from binpick_env.scenes.synthesis import SceneConfig, make_scene
from perception.metrics.average_precision import ap_summary, weighted_ap
from perception.metrics.matching import MATCHED_OVERLAPS, SceneMatches
from perception.runtime.files import json_text
from perception.segmentation.networks.sgpn import SgpnConfig
from perception.segmentation.training.presets import PRESETS
from tests.binpick_env.evaluation.segmentation.tiny_trainings import tiny_trainings

SCENES = SceneConfig(part="part_a", seed=7, num_parts=(2, 3), camera=CameraConfig(width=320, height=240))


def tiny(**changes: Any) -> AblationConfig:
    defaults: dict[str, Any] = {
        "scenes": SCENES, "count": 2, "training_seeds": 2, "steps": 2, "training_scenes": 2, "validation_scenes": 1,
        "trainings": tiny_trainings(),
    }  # fmt: skip
    return AblationConfig(**{**defaults, **changes})


def score(found: Sequence[bool], index: int = 0) -> SceneScore:
    """Return a scene of ``found`` parts, each found at all overlaps or at none."""
    each = len(MATCHED_OVERLAPS)
    right = np.array([k for k, hit in enumerate(found) if hit], np.int64)
    matches = SceneMatches(
        overlaps=MATCHED_OVERLAPS,
        truth_counts={0: len(found)},
        labels=np.zeros(each * len(right), np.int64),
        overlap_idx=np.tile(np.arange(each), len(right)),
        scores=np.repeat(1.0 - 0.1 * right, each),
        correct=np.ones(each * len(right), bool),
    )
    return SceneScore(
        index=index,
        matches=matches,
        bands=(matches,) * len(BANDS),
        wrong_side=3,
        contour=50,
        ap=ap_summary([matches]).ap,
        points=100,
        clutter=ClutterStats.from_fractions([0.5]),
        ms=dict.fromkeys(STAGES, 2.0),
        threads=1,
        git_commit="abc",
    )


def row(key: str, *each: Sequence[SceneScore], paper: tuple[float, float] | None = None) -> RowScores:
    scores = RowScores(key=key, name=key, paper=paper)
    for one in each:
        scores = scores.with_training(one, 5.0, {"5": 0.5}, 1.5)
    return scores


# --- the table -------------------------------------------------------------------------------------------------------


def test_rows_are_means_over_trainings() -> None:
    none, half, all_of = ([score(found)] * 4 for found in ([0, 0], [1, 0], [1, 1]))
    table = tabulate([row("a", none, half), row("b", all_of, all_of)], {}, np.random.default_rng(0), 50)
    a, b = table.rows
    alone = [ap_summary([one.matches for one in scores]).ap50 for scores in (none, half)]
    assert a.ap50 == pytest.approx(np.mean(alone))
    assert [one["ap50"] for one in a.each] == pytest.approx(alone)
    assert (b.ap, b.intervals["ap"]) == (1.0, (1.0, 1.0))
    assert a.gain is None
    assert b.gain is not None
    assert b.gain["ap75"][0] == pytest.approx(1.0 - a.ap75)


def test_commits_are_those_of_the_records_and_of_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablation_summary, "git_commit", lambda: "def")
    assert tabulate([row("a", [score([1])])], {}, np.random.default_rng(0), 5).git_commits == ["abc", "def"]


def test_the_printed_table_has_the_minutes_and_the_distance_of_each_training() -> None:
    scores = [score([1, 0])]
    learned = row("learned", scores).with_training(scores, 7.5, {"7.5": 0.5}, 12.34)
    radius = RowScores(key="floor", name="floor", paper=None).with_training(scores, 0.0015, {"0.0015": 0.4}, None)
    config = {"part": "tee", "sensor": "good", "seed": 7, "steps": 10}
    text = ablation_table.segmentation_ablation_table(tabulate([radius, learned], config, np.random.default_rng(0), 5))
    half = f"{100 * ap_summary([scores[0].matches]).ap50:.1f}"
    lines = [line.split() for line in text.splitlines()]
    assert ["floor", "1.5", "mm", half, half, "–", "2"] in lines
    assert ["learned", "5", "7.5", half, half, half, half, "1.5", "12.3", "2"] in lines


def test_intervals_cover_trainings_and_scenes() -> None:
    rng = np.random.default_rng(1)
    same = [score([1, 0])] * 6
    mixed = [score([bool(k % 2)] * 2) for k in range(6)]
    other = [score([1, 1])] * 6
    table = tabulate(
        [row("equal", same, same), row("scenes", mixed, mixed), row("trainings", same, other)], {}, rng, 400
    )
    widths = {r.key: r.intervals["ap50"][1] - r.intervals["ap50"][0] for r in table.rows}
    assert widths["equal"] == pytest.approx(0.0, abs=1e-12)
    assert widths["scenes"] > 0.3  # three of six scenes are whole
    low, high = table.rows[2].intervals["ap50"]
    assert (low, high) == pytest.approx((table.rows[2].each[0]["ap50"], 1.0))  # both drawn alike once in two


def test_a_gain_is_over_the_same_scenes_and_trainings() -> None:
    mixed = [score([bool(k % 2)] * 2) for k in range(6)]
    table = tabulate([row("a", mixed, mixed), row("b", mixed, mixed)], {}, np.random.default_rng(0), 100)
    gain = table.rows[1].gain
    assert gain is not None
    assert gain["ap50"] == pytest.approx((0.0, 0.0, 0.0))


def test_a_weight_of_two_is_the_scene_twice() -> None:
    scenes = [score([1, 0]).matches, score([1, 1]).matches, score([0, 0]).matches]
    twice = ap_summary([scenes[0], scenes[1], scenes[1]])
    expected = [twice.ap, twice.ap50, twice.ap75, twice.ap25]
    np.testing.assert_allclose(weighted_ap(scenes, np.array([[1.0, 2.0, 0.0]]))[0], expected)
    with pytest.raises(ValueError, match="weights must be"):
        weighted_ap(scenes, np.ones((1, 2)))


def test_nothing_to_tabulate_is_refused() -> None:
    for rows in ([], [row("a")]):
        with pytest.raises(ValueError, match="there is nothing to tabulate: a row without a training, or no row"):
            tabulate(rows, {}, np.random.default_rng(0))


# --- rows ------------------------------------------------------------------------------------------------------------


def test_successive_rows_differ_in_one_setting() -> None:
    how = trainings()
    assert len({(c.batch, c.points, c.optimizer, c.learning_rate, c.schedule, c.ema) for c in how.values()}) == 1
    assert (how["dgcnn"].pairs, how["sgpn"].network) == (how["sgpn"].pairs, SgpnConfig(trunk="pointnet"))
    assert how["dgcnn"] == replace(how["sgpn"], network=SgpnConfig(trunk="dgcnn"))
    assert how["focal"] == replace(how["dgcnn"], pairs=how["focal"].pairs)
    assert {c.pairs.anchors for c in how.values()} == {256}
    for name in ("network", "pairs", "alpha", "offset_weight"):
        assert getattr(how["ours"], name) == getattr(PRESETS["ours"], name)
    assert [how[name].pairs.kind for name in ("dgcnn", "focal")] == ["double_hinge", "focal_double_hinge"]
    methods = {r.key: r.method(Path("w") if r.network else None) for r in ROWS}
    assert [r.network for r in ROWS] == [None, "sgpn", "dgcnn", "focal", "focal", "focal", "ours"]
    assert methods["dgcnn"] == methods["sgpn"] == methods["focal"]
    assert methods["mask"] == replace(methods["focal"], mask=True)
    assert methods["grouped"] == replace(methods["mask"], grouping="ours")
    assert methods["ours"] == methods["grouped"]
    assert {m.subset for m in methods.values() if m.kind == "network"} == {BUDGET.points}
    assert methods["sgpn"].grouping == "merging"
    assert methods["euclidean"].kind == "euclidean"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"steps": 0}, "steps must be at least 1, got 0"),
        ({"training_seeds": 0}, "training_seeds must be at least 1, got 0"),
        ({"scenes": replace(SCENES, seed=0)}, "the training scenes are those of seed 0, which are evaluated; choose"),
        ({"scenes": replace(SCENES, seed=1)}, "the validation scenes are those of seed 1, which are evaluated; choose"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        tiny(**changes)


def test_scenes_of_the_evaluation_are_refused_for_training(tmp_path: Path) -> None:
    (tmp_path / "scenes.json").write_text(json.dumps({"part": "part_a", "seed": 7}))
    with pytest.raises(ValueError, match="the training scenes are those of seed 7, which are evaluated"):
        tiny(training=tmp_path)
    (tmp_path / "scenes.json").write_text(json.dumps({"part": "tee", "seed": 7}))
    tiny(training=tmp_path, validation=tmp_path / "nowhere", scenes=replace(SCENES, seed=1))
    (tmp_path / "scenes.json").write_text(json.dumps({"part": "./part_a", "seed": ablation.VALIDATION_SEED}))
    with pytest.raises(ValueError, match="training and validation scenes are both of seed 1; choose another folder"):
        tiny(training=tmp_path)


def test_missing_scenes_or_parts_leave_no_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere holds no scene_"):
        run_ablation(tiny(validation=tmp_path / "nowhere"), tmp_path / "out")
    with pytest.raises(ValueError, match="part must be one of"):
        run_ablation(tiny(scenes=replace(SCENES, part="teapot")), tmp_path / "out")
    assert not (tmp_path / "out").exists()


# --- a whole one -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, AblationTable, list[str]]:
    out, lines = tmp_path_factory.mktemp("ablation"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "make_scene", lru_cache(make_scene))  # which all rows are evaluated on
        table = run_ablation(tiny(), out, report=lines.append)
    return out, table, lines


@pytest.mark.slow
def test_every_row_is_trained_and_evaluated(done: tuple[Path, AblationTable, list[str]]) -> None:
    out, table, lines = done
    assert [r.key for r in table.rows] == [r.key for r in ROWS]
    assert [len(r.each) for r in table.rows] == [1, 2, 2, 2, 2, 2, 2]
    assert sorted(path.name for path in (out / "weights").iterdir()) == [
        "dgcnn-0", "dgcnn-1", "focal-0", "focal-1", "ours-0", "ours-1", "sgpn-0", "sgpn-1",
    ]  # fmt: skip
    assert "training ours 1: step 2 of 2" in lines
    assert "Euclidean components, training 0: scene 2 of 2" in lines
    for result in table.rows:
        assert all(f"{value:g}" in tried for value, tried in zip(result.chosen, result.tried, strict=True))
        best = max(ap or 0.0 for ap in result.tried[0].values())
        assert result.tried[0][f"{result.chosen[0]:g}"] == best
        assert set(result.intervals) == set(METRICS)
    assert table.rows[0].chosen[0] in ablation.RADII
    text = ablation_table.segmentation_ablation_table(table)
    assert "part_a · sensor good · 2 scenes · seed 7 · 2 trainings of 2 steps" in text
    assert "hand-labelled real scenes" in " ".join(text.split())
    assert "50.5" in text
    json.loads(json_text(asdict(table)))


@pytest.mark.slow
def test_an_ablation_is_resumed(done: tuple[Path, AblationTable, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    out, table, _ = done
    stamps = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    monkeypatch.setattr(ablation, "train", None)
    monkeypatch.setattr(ablation, "map_indices", None)
    again = run_ablation(tiny(), out)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()} == stamps
    assert [(r.ap, r.chosen) for r in again.rows] == [(r.ap, r.chosen) for r in table.rows]
    fewer = run_ablation(tiny(training_seeds=1, count=1), out)
    assert fewer.scenes == 1
    with pytest.raises(ValueError, match=r"holds an ablation of another configuration \(steps: 2 there, 3 here\)"):
        run_ablation(tiny(steps=3), out)


@pytest.mark.slow
def test_an_interrupted_training_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = tiny(steps=3, training_seeds=1, count=1)
    steps: list[str] = []

    def stop(line: str) -> None:
        if line == "training sgpn 0: step 2 of 3":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_ablation(config, tmp_path, report=stop)
    assert (tmp_path / "weights" / "sgpn-0" / "checkpoint.safetensors").exists()
    monkeypatch.setattr(ablation, "ROWS", ROWS[:2])
    (tmp_path / "rows" / "euclidean-0" / "choice.json").write_text("{")
    run_ablation(config, tmp_path, report=steps.append)
    assert [line for line in steps if line.startswith("training")] == ["training sgpn 0: step 3 of 3"]
    assert json.loads((tmp_path / "rows" / "euclidean-0" / "choice.json").read_text())["chosen"] in ablation.RADII

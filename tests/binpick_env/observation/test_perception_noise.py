"""The oracle that errs like the learned perceiver: its rates, its poses, its fit, its file."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from binpick_env.config import CameraConfig
from binpick_env.env import BinPickEnv
from binpick_env.evaluation.noise.comparison import FrameObservation, PartObservation, compare_with_truth
from binpick_env.evaluation.noise.fit import fit_noise, save_noise
from binpick_env.observation.factory import make_perceiver
from binpick_env.observation.noise_statistics import NoiseBin, Spread
from binpick_env.observation.noisy_oracle import NoisyOraclePerceiver, displaced
from binpick_env.observation.oracle import OraclePerceiver
from binpick_env.observation.part_class import CLASSES, PartClass
from binpick_env.observation.perception_noise import SHIPPED, GeneralNoise, NoiseError, PerceptionNoise
from binpick_env.parts import load_part
from perception.geometry import make_transform
from perception.metrics.pose_errors import pose_error
from perception.part import PartModel, Symmetry
from perception.shape import shape_signature
from tests.binpick_env.observation.test_perceiver import off_centre, view
from tests.binpick_env.small_cell import assert_same, small_env

RIGHT = Spread(translation=(0.0, 0.002), rotation=(0.0, 0.05), score=(0.7, 1.0))
WRONG = Spread(translation=(0.004, 0.02), rotation=(0.5, 3.0), score=(0.2, 0.8))
FALSE_SCORES = (0.1, 0.3)


def model(**changes: Any) -> PerceptionNoise:
    low = NoiseBin(high=0.5, count=100, offered=0.4, wrong=0.3, spread=RIGHT, visible_bias=0.1, fill_ratio=0.8)
    high = NoiseBin(high=1.0, count=100, offered=0.95, wrong=0.05, spread=RIGHT, visible_sigma=0.02, fill_ratio=1.1)
    values = {"bins": (low, high), "wrong": WRONG, "false_rate": 0.7, "false_score": FALSE_SCORES}
    return PerceptionNoise(**{**values, **changes})


def many_frames(noise: PerceptionNoise, count: int, seed: int = 0) -> list[FrameObservation]:
    """Judge what an oracle of this noise makes of ``count`` frames of 20 parts."""
    rng = np.random.default_rng(seed)
    perceiver, frames = NoisyOraclePerceiver(noise), []
    for k in range(count):
        seen = view(list(rng.uniform(0.02, 1.0, 20)), seed=k)
        frames.append(compare_with_truth(seen, perceiver.perceive(seen, rng)))
    return frames


def rows_of(frames: list[FrameObservation], low: float, high: float) -> list[PartObservation]:
    return [row for frame in frames for row in frame.parts if low < row.visible_fraction <= high]


def near(share: float, expected: float, n: int) -> bool:
    """Whether a share of n draws is within four standard errors."""
    return abs(share - expected) < 4 * np.sqrt(max(expected * (1 - expected), 1e-3) / n)


@pytest.mark.slow
def test_rates_and_errors_are_the_models() -> None:
    frames = many_frames(model(), 100)
    for each, low in zip(model().bins, (0.0, 0.5), strict=True):
        rows = rows_of(frames, low, each.high)
        offered = [row for row in rows if row.detected]
        assert near(len(offered) / len(rows), each.offered, len(rows))
        assert near(np.mean([not row.correct for row in offered]).item(), each.wrong, len(offered))
        right = [row for row in offered if row.correct]
        assert np.mean([row.translation_error for row in right]) == pytest.approx(0.001, rel=0.1)
        assert np.mean([row.rotation_error for row in right]) == pytest.approx(0.025, rel=0.1)
        assert np.mean([row.score for row in right]) == pytest.approx(0.85, rel=0.02)
        gaps = np.array([row.estimated_fraction - row.visible_fraction for row in offered])
        # At the ends the estimates are clipped.
        assert np.median(gaps) == pytest.approx(each.visible_bias, abs=0.01)
        assert np.mean([row.fill / row.visible_fraction for row in offered]) == pytest.approx(each.fill_ratio)
    false = [len(frame.false_scores) for frame in frames]
    assert np.mean(false) == pytest.approx(0.7, abs=4 * np.sqrt(0.7 / 100))
    scores = [score for frame in frames for score in frame.false_scores]
    assert 0.1 <= min(scores) <= max(scores) <= 0.3


@pytest.mark.slow
def test_a_fitted_model_gives_back_the_rates_of_its_sample() -> None:
    """Missed, wrong, errors, scores and false ones: drawn again from the fit, within the sampling error of both."""
    sample = many_frames(model(), 60)
    fitted = fit_noise(sample)
    again = many_frames(fitted, 60, seed=1)
    for low, high in ((0.0, 0.3), (0.3, 0.5), (0.5, 0.8), (0.8, 1.0)):
        one, other = rows_of(sample, low, high), rows_of(again, low, high)
        shares = [np.mean([row.detected for row in rows]).item() for rows in (one, other)]
        assert near(shares[1], shares[0], min(len(one), len(other)) // 2)
        one, other = ([row for row in rows if row.detected] for rows in (one, other))
        shares = [np.mean([row.correct for row in rows]).item() for rows in (one, other)]
        assert near(shares[1], shares[0], min(len(one), len(other)) // 2)
    for name in ("translation_error", "rotation_error", "score"):
        for right in (True, False):
            one, other = (
                [getattr(row, name) for row in rows_of(frames, 0.0, 1.0) if row.detected and row.correct is right]
                for frames in (sample, again)
            )
            assert np.median(other) == pytest.approx(np.median(one), rel=0.25), (name, right)
    assert fitted.false_rate == pytest.approx(0.7, abs=4 * np.sqrt(0.7 / 60))


def test_the_fit_counts_by_hand() -> None:
    right = PartObservation(
        visible_fraction=0.95,
        detected=True,
        correct=True,
        translation_error=0.001,
        rotation_error=0.01,
        score=0.9,
        estimated_fraction=0.85,
    )
    wrong = PartObservation(
        visible_fraction=0.95,
        detected=True,
        translation_error=0.03,
        rotation_error=3.0,
        score=0.4,
        estimated_fraction=0.95,
        fill=1.9,
    )
    frames = [
        FrameObservation(parts=(right, wrong, PartObservation(visible_fraction=0.95)), false_scores=(0.2,)),
        FrameObservation(parts=(PartObservation(visible_fraction=0.05),), false_scores=()),
    ]
    noise = fit_noise(frames, {"seed": 3})
    top, bottom = noise.bin_of(0.95), noise.bin_of(0.05)
    assert (top.count, top.offered, top.wrong) == (3, pytest.approx(2 / 3), 0.5)
    assert (top.visible_bias, top.visible_sigma) == (pytest.approx(-0.05), pytest.approx(0.05))
    assert top.fill_ratio == pytest.approx(1.0)
    assert (bottom.count, bottom.offered) == (1, 0.0)
    assert (noise.wrong.translation[0], noise.wrong.rotation[-1]) == (0.03, 3.0)
    assert (noise.false_rate, noise.false_score[0], noise.provenance) == (0.5, 0.2, {"seed": 3})


def test_nothing_right_cannot_be_fitted() -> None:
    with pytest.raises(ValueError, match="1 frames hold no correct pose"):
        fit_noise([FrameObservation(parts=(PartObservation(visible_fraction=0.5),), false_scores=())])


def test_it_sees_by_the_cameras_reported_place() -> None:
    true = view([0.9, 0.7, 0.95])
    moved = replace(true, hand_eye=np.array([0.01, -0.02, 0.003]))
    perceiver = NoisyOraclePerceiver(model(false_rate=3.0))
    first, second = (perceiver.perceive(each, np.random.default_rng(0)).candidates for each in (true, moved))
    assert len(first) == len(second) > 3
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(other.T_world_part[:3, 3] - one.T_world_part[:3, 3], moved.hand_eye, atol=1e-12)
        np.testing.assert_array_equal(other.T_world_part[:3, :3], one.T_world_part[:3, :3])


def test_a_perfect_oracle_is_all_right() -> None:
    seen = view([0.9, 0.2, 0.7])
    judged = compare_with_truth(seen, OraclePerceiver().perceive(seen, np.random.default_rng(0)))
    assert [row.detected for row in judged.parts] == [True, False, True]
    assert all(
        row.correct and row.translation_error == 0.0 and row.estimated_fraction == row.visible_fraction
        for row in judged.parts
        if row.detected
    )
    assert judged.false_scores == ()


def test_errors_are_measured_modulo_symmetry() -> None:
    """A turn by the drawn angle is one by that angle to the criterion too, for a wheel as well."""
    rng = np.random.default_rng(2)
    wheel = trimesh.creation.cylinder(radius=0.03, height=0.02)
    wheel.apply_translation((0.02, 0.0, 0.01))
    symmetry = Symmetry(axis=np.array([0.0, 0.0, 1.0]))
    for part in (off_centre(), PartModel.from_mesh("wheel", wheel, symmetry)):
        seen = view([1.0], part)
        for angle in (0.0, 0.02, 0.6, 1.5):
            T = displaced(seen, seen.T_world_parts[0], 0.003, angle, rng)
            error = pose_error(T, seen.T_world_parts[0], part)
            assert error.translation == pytest.approx(0.003)
            assert error.rotation == pytest.approx(angle, abs=1e-6)


def test_chance_is_the_generators_and_an_empty_view_has_none() -> None:
    seen = view([0.9, 0.6, 0.3])
    perceiver = make_perceiver("oracle", seen.part, seen.workspace, model())
    one, other = (perceiver.perceive(seen, np.random.default_rng(4)).candidates for _ in range(2))
    assert [c.score for c in one] == [c.score for c in other] == sorted((c.score for c in one), reverse=True)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.T_world_part, b.T_world_part)
    assert perceiver.perceive(view([0.0, 0.0]), np.random.default_rng(0)).candidates == []


def test_a_model_survives_its_file(tmp_path: Path) -> None:
    save_noise(tmp_path / "tee_good.json", model(provenance={"seed": 1}))
    assert PerceptionNoise.load(tmp_path / "tee_good.json") == model(provenance={"seed": 1})


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"version": 0}, "is of version 0, this code reads 1"),
        ({"bins": [{"high": 1.0}]}, "the noise model is incomplete"),
        ({"wrong": {"translation": [0, 1]}}, "the noise model is incomplete"),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path: Path, change: dict[str, Any], text: str) -> None:
    save_noise(tmp_path / "a.json", model())
    values = json.loads((tmp_path / "a.json").read_text())
    with pytest.raises(NoiseError, match=text):
        PerceptionNoise.from_plain(values | change)


def test_a_missing_or_damaged_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(NoiseError, match="holds no noise model"):
        PerceptionNoise.load(tmp_path / "none.json")
    (tmp_path / "half.json").write_text("{")
    with pytest.raises(NoiseError, match=r"half\.json holds no noise model"):
        PerceptionNoise.load(tmp_path / "half.json")
    save_noise(tmp_path / "tee_good.json", model())
    with pytest.raises(
        NoiseError, match=r"tee_good\.json cannot be used: the noise model for every part is incomplete"
    ):
        GeneralNoise.load(tmp_path / "tee_good.json")
    for bins, text in (([{"high": 0.5}], "is incomplete"), ([], r"bins must rise and end at 1, got \[\]")):
        (tmp_path / "bad.json").write_text(json.dumps(model().plain() | {"bins": bins}))
        with pytest.raises(NoiseError, match=rf"bad\.json cannot be used: .*{text}"):
            PerceptionNoise.load(tmp_path / "bad.json")


def test_a_part_without_a_model_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(
        NoiseError,
        match=r"--part tee --sensor harsh, or one for every part .* --part generated --sensor harsh",
    ):
        PerceptionNoise.for_part("tee", "harsh")
    spoon = tmp_path / "my spoon.stl"
    trimesh.creation.box((80, 12, 10)).export(spoon)
    with pytest.raises(NoiseError, match=rf"fit-noise --part '{re.escape(str(spoon))}' --sensor harsh, or one for"):
        PerceptionNoise.for_part(spoon, "harsh")
    with pytest.raises(NoiseError, match=r"of .tee. under sensor .none., and none for every part .there are: "):
        BinPickEnv("tee", num_parts=1, perception="oracle", sensor="none", pose_noise="learned")
    misspelt: Any = "lerned"
    with pytest.raises(
        ValueError, match="pose_noise must be a PoseNoise, a PerceptionNoise or 'learned', got 'lerned'"
    ):
        BinPickEnv("tee", num_parts=1, perception="oracle", pose_noise=misspelt)


def general(**changes: Any) -> GeneralNoise:
    """Return a model for every part whose rate of false candidates is the number of the class."""
    classes = {key: model(false_rate=float(k)) for k, key in enumerate(CLASSES)}
    return GeneralNoise(**{"classes": classes, "provenance": {"seed": 2}, **changes})


def test_a_model_for_every_part_survives_its_file_and_is_complete(tmp_path: Path) -> None:
    save_noise(tmp_path / "general_good.json", general())
    assert GeneralNoise.load(tmp_path / "general_good.json") == general()
    with pytest.raises(ValueError, match=r"must have all 9 classes, got none for .PartClass.size='small', shape='c"):
        general(classes={key: model() for key in CLASSES[1:]})
    with pytest.raises(NoiseError, match=r"the noise model for every part is incomplete .KeyError.'classes'"):
        GeneralNoise.from_plain(model().plain())
    with pytest.raises(NoiseError, match="is of version 7, this code reads 1"):
        GeneralNoise.from_plain(general().plain() | {"version": 7})
    with pytest.raises(NoiseError, match="holds no noise model"):
        GeneralNoise.load(tmp_path / "none.json")


def test_the_model_for_every_part_serves_a_part_in_metres_by_its_class(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", logger="binpick_env")
    monkeypatch.setattr("binpick_env.observation.perception_noise.SHIPPED", tmp_path)
    save_noise(tmp_path / "general_good.json", general())
    rod = tmp_path / "rod.stl"
    trimesh.creation.box((80, 12, 10)).export(rod)
    noise = PerceptionNoise.for_part(rod)
    d_max = load_part(rod).model.d_max
    assert d_max == pytest.approx(0.08151, abs=1e-5)
    assert noise.false_rate == CLASSES.index(PartClass("medium", "slender"))
    assert noise.wrong.translation == pytest.approx([d_max * each for each in WRONG.translation])
    for each, unit in zip(noise.bins, model().bins, strict=True):
        assert each.spread.translation == pytest.approx([d_max * share for share in unit.spread.translation])
        assert (each.spread.rotation, each.spread.score) == (unit.spread.rotation, unit.spread.score)
        assert (each.offered, each.wrong, each.fill_ratio) == (unit.offered, unit.wrong, unit.fill_ratio)
    assert "noise model for every part, as of medium slender parts" in caplog.text
    near = PerceptionNoise.for_part(rod, camera=CameraConfig(distance=0.3))
    assert near.false_rate == CLASSES.index(PartClass("large", "slender"))


def test_a_model_of_the_part_itself_is_recognised_by_shape_and_precedes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The file's name does not matter; without a shape, as older versions wrote, it does."""
    caplog.set_level("INFO", logger="binpick_env")
    monkeypatch.setattr("binpick_env.observation.perception_noise.SHIPPED", tmp_path)
    save_noise(tmp_path / "general_good.json", general())
    block = tmp_path / "block.stl"
    trimesh.creation.box((80, 12, 10)).export(block)
    shape = list(shape_signature(load_part(block).model))
    save_noise(tmp_path / "another_good.json", model(false_rate=0.25, provenance={"shape": shape}))
    save_noise(tmp_path / "tee_good.json", model(false_rate=0.5, provenance={}))
    save_noise(tmp_path / "bracket_good.json", model(false_rate=0.75, provenance={"shape": shape}))
    assert PerceptionNoise.for_part(block).false_rate == 0.25
    assert "noise model another_good.json, which was fitted to this part" in caplog.text
    assert PerceptionNoise.for_part("tee").false_rate == 0.5
    assert PerceptionNoise.for_part("bracket").false_rate in range(9)  # that file is of another shape


def test_the_shipped_models_of_the_catalogue_serve_by_name() -> None:
    for name in ("part_a", "part_b", "part_c", "tee", "bracket"):
        noise = PerceptionNoise.for_part(name)
        assert noise.provenance["part"] == name
        assert noise == PerceptionNoise.load(SHIPPED / f"{name}_good.json")


def test_the_environment_takes_the_model_of_its_part_and_sensor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two copies see the same, bit for bit, and what they see is not the truth."""
    monkeypatch.setattr("binpick_env.observation.perception_noise.SHIPPED", tmp_path)
    save_noise(tmp_path / "tee_good.json", model())
    envs = [small_env(pose_noise="learned") for _ in range(2)]
    for one, other in zip(*(env.reset(seed=3) for env in envs), strict=True):
        assert_same(one, other)
    env = envs[0]
    assert env.candidates
    own = [candidate for candidate in env.candidates if candidate.part >= 0]
    assert all(np.any(c.T_world_part != env.labelled_capture.T_world_parts[c.part]) for c in own)


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: Spread(translation=(0.0,), rotation=(0, 1), score=(0, 1)), "translation must hold two or more rising"),
        (lambda: Spread(translation=(1.0, 0.0), rotation=(0, 1), score=(0, 1)), "translation must hold two or more"),
        (lambda: Spread(translation=(0, 1), rotation=(0, 1), score=(0, 1.5)), "score must not exceed 1, got 1.5"),
        (lambda: NoiseBin(high=1.0, count=0, offered=1.2, wrong=0, spread=RIGHT), r"offered must be in \[0, 1\], got"),
        (lambda: NoiseBin(high=1.0, count=-1, offered=1, wrong=0, spread=RIGHT), "count must not be negative, got -1"),
        (lambda: model(bins=()), r"bins must rise and end at 1, got \[\]"),
        (lambda: model(bins=model().bins[:1]), r"bins must rise and end at 1, got \[0.5\]"),
        (lambda: model(false_rate=-0.1), "false_rate must not be negative, got -0.1"),
    ],
)
def test_nonsense_is_refused(build: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        build()


def test_a_false_candidate_is_no_parts() -> None:
    seen = view([0.9], seed=3)
    silent = tuple(NoiseBin(high=1.0, count=1, offered=0.0, wrong=0.0, spread=RIGHT) for _ in range(1))
    perceiver = NoisyOraclePerceiver(model(bins=silent, false_rate=3.0))
    candidates = perceiver.perceive(seen, np.random.default_rng(0)).candidates
    assert candidates
    assert {c.part for c in candidates} == {-1}
    centre = (seen.T_world_parts[0] @ make_transform(translation=seen.part.centre))[:3, 3]
    assert all(np.linalg.norm(c.centre_world - centre) <= seen.part.d_max / 2 for c in candidates)

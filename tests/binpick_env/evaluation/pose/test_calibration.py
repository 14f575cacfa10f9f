"""Fit of the confidence to poses with known ground truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from binpick_env.evaluation.pose.calibration import (
    Sample,
    fit_confidence,
    load_sample,
    operating_points,
    predicted_confidence,
)
from binpick_env.evaluation.pose.record import DOUBT_COLUMNS, VERDICT_COLUMNS
from binpick_env.evaluation.segmentation.record import record_path
from perception.geometry import Floats
from perception.pose.verification.confidence import COEFFICIENTS, ConfidenceConfig
from tests.binpick_env.evaluation.pose.pose_records import bracket, estimates, moved, record

TRUTH = ConfidenceConfig(
    bias=-2.0,
    edge_score=3.0,
    support=-1.0,
    violation=-2.0,
    margin=1.5,
    close_margin=1.1,
    score_drop=0.8,
    close_score_drop=-0.6,
    size=0.4,
    rotation_error=-120.0,
)


UNITS = np.array([np.pi / 180 if name == "rotation_error" else 1.0 for name in COEFFICIENTS])


def coefficients(config: ConfidenceConfig) -> list[float]:
    """Return the coefficients, that of the expected error in units of degrees like the others in size."""
    return [getattr(config, name) * UNITS[k] for k, name in enumerate(COEFFICIENTS)]


def drawn(count: int = 40_000) -> Sample:
    """Return poses that are correct with the probability that `TRUTH` gives."""
    rng = np.random.default_rng(0)
    predictors = rng.uniform(0, 1, (count, len(coefficients(TRUTH))))
    chance = 1 / (1 + np.exp(-(TRUTH.bias + predictors @ np.array(coefficients(TRUTH)))))
    right = rng.uniform(size=count) < chance
    return sample_of(predictors * UNITS, right)


def sample_of(predictors: Floats, right: NDArray[np.bool_], missed: int = 0) -> Sample:
    """Return a sample of good frames without mismatch."""
    nothing = np.zeros(len(right))
    return Sample(predictors=predictors, mismatch=nothing, noise=nothing, correct=right, to_find=right, missed=missed)


def test_the_fit_recovers_the_coefficients_of_the_sample() -> None:
    found = fit_confidence(drawn())
    np.testing.assert_allclose(coefficients(found), coefficients(TRUTH), atol=0.25)
    assert found.bias == pytest.approx(TRUTH.bias, abs=0.15)
    assert (found.clear, found.close) == (ConfidenceConfig().clear, ConfidenceConfig().close)


def test_predicted_confidences_are_calibrated() -> None:
    sample = drawn()
    chance = predicted_confidence(sample, fit_confidence(sample))
    for low in (0.1, 0.4, 0.7):
        inside = (chance >= low) & (chance < low + 0.1)
        assert sample.correct[inside].mean() == pytest.approx(chance[inside].mean(), abs=0.03)


@pytest.mark.parametrize("right", [True, False])
def test_a_sample_without_correct_or_wrong_poses_is_refused(right: bool) -> None:
    sample = replace(drawn(10), correct=np.full(10, right))
    with pytest.raises(ValueError, match=r"correct and wrong poses are needed, got \d+ correct of 10"):
        fit_confidence(sample)


def test_operating_points_by_hand() -> None:
    nothing = dict.fromkeys(("bias", *COEFFICIENTS), 0.0)
    config = replace(TRUTH, **(nothing | {"edge_score": 1.0}))
    predictors = np.ones((4, len(COEFFICIENTS)))
    predictors[:, 0] = (-2.0, -1.0, 1.0, 2.0)  # scores .12, .27, .73, .88
    right = np.array([False, True, False, True])
    sample = sample_of(predictors, right, missed=2)
    points = operating_points(sample, config, (0.0, 0.5, 0.8, 0.95))
    assert [point[1] for point in points] == [4, 2, 1, 0]
    assert [point[2] for point in points[:3]] == [0.5, 0.5, 1.0]
    assert np.isnan(points[3][2])
    assert [point[3] for point in points] == [0.5, 0.25, 0.25, 0.0]


def test_a_sample_is_loaded_from_records(tmp_path: Path) -> None:
    true = record().T_cam_parts
    poses = np.stack([true[0], moved(true[1], degrees=20.0), true[2]])
    verdicts = np.tile(np.arange(len(VERDICT_COLUMNS)) / 10, (3, 1))
    verdicts[:, VERDICT_COLUMNS.index("margin")] = (np.inf, -9.0, 0.5)
    verdicts[:, VERDICT_COLUMNS.index("score_drop")] = (-4.0, np.inf, 0.25)
    verdicts[:, VERDICT_COLUMNS.index("size")] = (1.0, np.e, 100.0)
    doubts = np.zeros((3, len(DOUBT_COLUMNS)))
    doubts[:, DOUBT_COLUMNS.index("patch")] = (0.0, 7.0, 4.0)
    doubts[:, DOUBT_COLUMNS.index("noise")] = 0.002
    doubts[:, DOUBT_COLUMNS.index("rotation_error")] = (0.0, 0.1, 9.0)
    changes = estimates(poses, [0.9, 0.8, 0.7], [0, 1, 2]) | {"verdicts": verdicts, "doubts": doubts}
    record(**changes).save(record_path(tmp_path, 0))
    sample = load_sample(tmp_path, bracket())
    assert sample.correct.tolist() == [True, False, True]
    assert sample.to_find.tolist() == [True, False, False]  # the third part is hidden by more than half
    assert sample.missed == 1
    np.testing.assert_allclose(sample.mismatch, [0.0, 2 * ConfidenceConfig().patch_weight, 0.0])  # 5 say nothing
    assert sample.noise.tolist() == [0.002] * 3
    np.testing.assert_allclose(sample.predictors[:, :3], [[0.0, 0.2, 0.3]] * 3)
    np.testing.assert_allclose(sample.predictors[:, 3], [3.0, -3.0, 0.5])
    np.testing.assert_allclose(sample.predictors[:, 4], [1.0, -1.0, 0.5])
    np.testing.assert_allclose(sample.predictors[:, 5], [-3.0, 3.0, 0.25])
    np.testing.assert_allclose(sample.predictors[:, 6], [-1.0, 1.0, 0.25])
    np.testing.assert_allclose(sample.predictors[:, 7], [0.0, 1.0, np.log(100.0)])
    exact, unknown = ConfidenceConfig().exact, ConfidenceConfig().unknown
    np.testing.assert_allclose(sample.predictors[:, 8], [0.0, 0.1 - exact, unknown - exact])


def test_a_record_of_an_older_version_is_refused(tmp_path: Path) -> None:
    record(doubts=np.full((4, len(DOUBT_COLUMNS)), np.nan)).save(record_path(tmp_path, 0))
    message = r"scene_00000.npz is of an older version, without mismatch, noise or expected error: run binpick"
    with pytest.raises(ValueError, match=message):
        load_sample(tmp_path, bracket())


def test_the_weight_of_the_noise_is_fitted_and_the_mismatch_is_not() -> None:
    rng, clean = np.random.default_rng(1), drawn()
    noise = rng.uniform(0.0, 0.003, len(clean.correct))
    mismatch = np.where(rng.uniform(size=len(noise)) < 0.3, -2.0, 0.0)
    truth = replace(TRUTH, noise=0.001, noise_weight=-900.0)
    sample = replace(clean, noise=noise, mismatch=mismatch)
    right = rng.uniform(size=len(noise)) < predicted_confidence(sample, truth)
    found = fit_confidence(replace(sample, correct=right), truth)
    np.testing.assert_allclose(coefficients(found), coefficients(TRUTH), atol=0.3)
    assert found.noise_weight == pytest.approx(-900.0, abs=60.0)


def test_noise_that_speaks_for_a_pose_is_left_out_of_the_fit() -> None:
    clean, rng = drawn(), np.random.default_rng(2)
    noisy = rng.uniform(size=len(clean.correct)) < 0.5
    right = rng.uniform(size=len(noisy)) < np.where(noisy, 0.9, 0.7)
    sample = replace(clean, noise=np.where(noisy, 0.003, 0.0005), correct=right)
    found = fit_confidence(sample)
    assert found.noise_weight == 0
    assert predicted_confidence(sample, found).mean() == pytest.approx(right.mean(), abs=0.01)
    with pytest.raises(ValueError, match="the noise of every frame must be finite"):
        fit_confidence(replace(sample, noise=np.full(len(right), np.inf)))


def test_a_folder_without_records_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="holds no records of binpick evaluate-pose"):
        load_sample(tmp_path, bracket())

"""The chance that a pose is right, by hand."""

from dataclasses import fields, replace

import numpy as np
import pytest

from perception.pose.verification.confidence import (
    COEFFICIENTS,
    ConfidenceConfig,
    confidence,
    confidences,
    error_penalty,
    mismatch_penalty,
    predictors,
)
from perception.pose.verification.mismatch import Mismatch
from perception.pose.verification.verification import Verdict

VERDICT = Verdict(edge_score=0.5, explained=0.25, support=0.75, violation=0.125, measured=0.9, logit=1.0)
DROP = 1.5
PLAIN = ConfidenceConfig(
    bias=-1.0,
    edge_score=2.0,
    support=-2.0,
    violation=-8.0,
    margin=0.5,
    close_margin=0.75,
    score_drop=-1.5,
    close_score_drop=0.125,
    size=0.25,
    rotation_error=-40.0,
    clear=3.0,
    close=1.0,
    exact=0.02,
    unknown=0.2,
)


def logistic(x: float) -> float:
    return float(1 / (1 + np.exp(-x)))


def test_it_is_the_logistic_of_a_weighted_sum() -> None:
    without_size = -1.0 + 1.0 - 1.5 - 1.0 + 0.5 * 2.0 + 0.75 * 1.0 - 1.5 * 1.5 + 0.125 * 1.0
    assert confidence(VERDICT, 2.0, DROP, 1, PLAIN) == pytest.approx(logistic(without_size))
    assert confidence(VERDICT, 2.0, DROP, 100, PLAIN) == pytest.approx(logistic(without_size + 0.25 * np.log(100)))


def test_a_clear_margin_is_clear() -> None:
    def sure(margin: float, config: ConfidenceConfig = PLAIN) -> float:
        return confidence(VERDICT, margin, DROP, 50, config)

    assert sure(2.9) < sure(3.0)
    assert sure(40.0) == sure(np.inf) == sure(3.0)
    assert sure(-np.inf) == sure(-3.0) < sure(-2.9)
    assert sure(2.0, replace(PLAIN, clear=1.5)) == sure(1.5)
    assert sure(2.0, replace(PLAIN, clear=1.5, margin=0.0)) == sure(1.0, replace(PLAIN, margin=0.0))


def test_a_clear_score_drop_is_clear() -> None:
    dropping = replace(PLAIN, score_drop=1.0)

    def sure(score_drop: float, config: ConfidenceConfig = dropping) -> float:
        return confidence(VERDICT, 0.5, score_drop, 50, config)

    assert sure(2.9) < sure(3.0)
    assert sure(40.0) == sure(np.inf) == sure(3.0)
    assert sure(-np.inf) == sure(-3.0) < sure(-2.9)
    assert sure(2.0, replace(dropping, clear=1.5)) == sure(1.5)


def test_predictors_by_hand() -> None:
    found = predictors(
        np.array([[0.5, 0.75, 0.125], [0.1, 0.2, 0.3]]),
        np.array([2.0, -np.inf]),
        np.array([0.25, np.inf]),
        np.array([7, 1]),
        np.array([0.05, 2.0]),
        PLAIN,
    )
    expected = [
        [0.5, 0.75, 0.125, 2.0, 1.0, 0.25, 0.25, np.log(7), 0.05 - 0.02],
        [0.1, 0.2, 0.3, -3.0, -1.0, 3.0, 1.0, 0.0, 0.2 - 0.02],
    ]
    np.testing.assert_array_equal(found, expected)


def test_each_coefficient_weighs_its_own_predictor() -> None:
    values = np.array([[0.5, 0.75, 0.125, 2.0, 1.0, 1.5, 0.875, np.log(7), 0.03]])
    limits = {"clear", "close", "exact", "unknown", "patch", "stray", "noise"}
    penalties = {"patch_weight", "stray_weight", "noise_weight"}
    assert set(COEFFICIENTS) == {f.name for f in fields(PLAIN)} - {"bias"} - limits - penalties
    for place, name in enumerate(COEFFICIENTS):
        only = replace(PLAIN, bias=0.0, **(dict.fromkeys(COEFFICIENTS, 0.0) | {name: 1.0}))
        assert confidences(values, only) == pytest.approx([logistic(values[0, place])]), name


def test_a_margin_near_zero_counts_more_than_the_same_change_of_a_clear_one() -> None:
    sure = [confidence(VERDICT, margin, DROP, 60) for margin in (0.0, 1.0, 2.0, 3.0)]
    logits = np.log(sure) - np.log1p(-np.array(sure))
    gain = np.diff(logits)
    assert gain[0] > 3 * gain[1]
    assert gain[1] == pytest.approx(gain[2])


def test_agreement_raises_the_confidence_and_violation_lowers_it() -> None:
    sure = confidence(VERDICT, 1.0, DROP, 60)
    assert 0 < sure < 1
    assert confidence(replace(VERDICT, edge_score=1.0, support=1.0), 1.0, DROP, 60) > sure
    assert confidence(replace(VERDICT, violation=0.5), 1.0, DROP, 60) < sure
    assert confidence(VERDICT, 0.0, DROP, 60) < sure < confidence(VERDICT, 2.0, DROP, 60)
    assert confidence(VERDICT, 1.0, DROP, 20) < sure < confidence(VERDICT, 1.0, DROP, 200)
    assert confidence(VERDICT, 1.0, 0.5, 60) < sure < confidence(VERDICT, 1.0, 2.5, 60)


def test_a_rotation_that_noise_leaves_open_lowers_the_confidence() -> None:
    def sure(degrees: float) -> float:
        penalty = error_penalty(float(np.deg2rad(degrees)), ConfidenceConfig())
        return confidence(VERDICT, 1.0, DROP, 60, penalty=penalty)

    assert sure(0.0) == sure(1.0) > sure(3.0) > sure(6.0) > sure(20.0) == sure(90.0)


@pytest.mark.parametrize(("name", "more"), [("patch", 3), ("stray", 0.05), ("noise", 0.0005)])
def test_structure_that_does_not_match_and_noise_lower_the_confidence(name: str, more: float) -> None:
    sure, config = confidence(VERDICT, 1.0, DROP, 60), ConfidenceConfig()

    def lowered(value: float) -> float:
        values = {"patch": 0, "stray": 0.0, "noise": 0.0} | {name: value}
        noise = values.pop("noise")
        penalty = mismatch_penalty(Mismatch(**values), noise, config)
        return confidence(VERDICT, 1.0, DROP, 60, penalty=penalty)

    limit = getattr(config, name)
    assert lowered(limit) == sure
    lower = lowered(limit + more)
    drop = np.log(sure / (1 - sure)) - np.log(lower / (1 - lower))
    assert drop == pytest.approx(-more * getattr(config, f"{name}_weight"))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("patch", -1, "patch must not be negative, got -1"),
        ("stray", np.inf, "stray must not be negative, got inf"),
        ("noise", -0.1, "noise must not be negative, got -0.1"),
        ("patch_weight", 0.1, "patch_weight must be 0 or less, got 0.1"),
        ("stray_weight", -np.inf, "stray_weight must be 0 or less, got -inf"),
    ],
)
def test_a_mismatch_that_helps_is_refused(name: str, value: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(PLAIN, **{name: value})


@pytest.mark.parametrize("limits", [{"exact": 0.3}, {"exact": -0.1}, {"unknown": np.inf}])
def test_limits_of_the_expected_error_in_the_wrong_order_are_refused(limits: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="0 <= exact < unknown is required, got"):
        replace(PLAIN, **limits)


def test_an_expected_error_that_is_nan_is_refused() -> None:
    with pytest.raises(ValueError, match="rotation_error must not be NaN, got nan"):
        error_penalty(np.nan, PLAIN)


def test_the_penalty_of_an_expected_error_is_its_share_of_the_regression() -> None:
    found = predictors(np.zeros((1, 3)), np.zeros(1), np.zeros(1), np.ones(1), np.array([0.11]), PLAIN)
    assert error_penalty(0.11, PLAIN) == pytest.approx(PLAIN.rotation_error * found[0, -1])
    assert found[0, -1] == pytest.approx(0.09)


def test_extremes_stay_in_bounds() -> None:
    for bias in (-1e6, 1e6):
        assert confidence(VERDICT, 0.0, DROP, 10, replace(PLAIN, bias=bias)) == (bias > 0)


@pytest.mark.parametrize(
    ("margin", "score_drop", "size", "message"),
    [
        (1.0, 2.0, 0, "size must be at least 1, got 0"),
        (1.0, 2.0, -3, "size must be at least 1, got -3"),
        (np.nan, 2.0, 10, "margin must not be NaN, got nan"),
        (1.0, np.nan, 10, "score_drop must not be NaN, got nan"),
    ],
)
def test_nonsense_is_refused(margin: float, score_drop: float, size: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        confidence(VERDICT, margin, score_drop, size)


@pytest.mark.parametrize("name", ["bias", *COEFFICIENTS])
def test_a_coefficient_that_is_no_number_is_refused(name: str) -> None:
    for nonsense in (np.nan, np.inf):
        with pytest.raises(ValueError, match=f"{name} must be finite, got {nonsense}"):
            replace(PLAIN, **{name: nonsense})


@pytest.mark.parametrize(
    ("close", "clear"), [(1.0, 1.0), (1.0, 0.5), (0.0, 3.0), (-1.0, 3.0), (1.0, np.nan), (1.0, np.inf)]
)
def test_limits_out_of_order_are_refused(close: float, clear: float) -> None:
    with pytest.raises(ValueError, match=f"0 < close < clear is required, got {close} and {clear}"):
        replace(PLAIN, clear=clear, close=close)

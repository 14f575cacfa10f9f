"""Scores are printed so that the table agrees with the bound of verified poses."""

import pytest

from policies.frames.frame_record import _rounded_down


@pytest.mark.parametrize(
    ("score", "printed"), [(0.8996, 0.899), (0.89999, 0.899), (0.9, 0.9), (0.29, 0.29), (1.0, 1.0), (0.0, 0.0)]
)
def test_scores_are_rounded_down(score: float, printed: float) -> None:
    assert _rounded_down(score) == printed

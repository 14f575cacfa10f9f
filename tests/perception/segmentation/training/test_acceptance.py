"""Which networks are good enough to be used."""

import math
from typing import Any

import pytest

from perception.segmentation.training.acceptance import objection, scores


def line(ap50: float | None, ap: float | None = None) -> dict[str, Any]:
    return {"step": 1, "validation": {"ap50": ap50, "ap75": 0.25, "ap": ap50 if ap is None else ap}}


@pytest.mark.parametrize(
    ("last", "first", "text"),
    [
        (line(0.5), None, None),
        (line(0.499), None, "its AP50 on the validation scenes, 0.499, is under 0.5"),
        (line(math.nan), None, "AP50 on the validation scenes, nan"),
        (line(0.9, 0.7), line(0.95, 0.7), None),
        (line(0.9, 0.6), line(0.8, 0.7), "its AP on the validation scenes, 0.600, is under the 0.700 it started from"),
        (line(0.9, 0.6), {"step": 0}, None),
        (line(0.9, 0.6), {"step": 0, "validation": {"ap50": None, "ap": None}}, None),
        ({"step": 1}, line(0.9), None),
    ],
)
def test_a_network_must_be_useful_and_no_worse_than_its_start(
    last: dict[str, Any], first: dict[str, Any] | None, text: str | None
) -> None:
    found = objection(last, first)
    assert (found is None) == (text is None)
    assert (text or "") in (found or "")


def test_scores_are_shown_with_their_names() -> None:
    assert scores(line(0.5, 0.4)) == "AP50 0.500, AP75 0.250, AP 0.400"
    assert scores({"validation": {"ap50": None, "ap": 0.4}}) == "AP 0.400"
    assert scores({"step": 0}) == ""

"""The plot of a training: its curves lie where the log says."""

import xml.etree.ElementTree as ET
from typing import Any

import pytest

from binpick_env.evaluation.segmentation.training_plot import ap_plot

SVG = "{http://www.w3.org/2000/svg}"


def line(step: int, minutes: float, ap50: float | None, **others: Any) -> dict[str, Any]:
    return {"step": step, "minutes": minutes, "validation": {"ap50": ap50, "ap75": 0.5, "ap": 0.25}, **others}


def curve(root: ET.Element, k: int) -> list[tuple[float, float]]:
    (drawn,) = (one for one in root.iter(f"{SVG}polyline") if one.get("class") == f"line-{k}")
    return [tuple(map(float, point.split(","))) for point in drawn.get("points", "").split()]  # type: ignore[misc]


def test_curves_are_drawn_against_minutes() -> None:
    text = ap_plot([line(0, 0.0, 0.0), {"step": 5, "minutes": 1.0}, line(9, 2.0, 1.0)])
    assert text is not None
    root = ET.fromstring(text)
    (left, bottom), (right, top) = curve(root, 0)
    assert (right - left, bottom - top) == (340, 340)  # the axis ends at 2 minutes
    assert [y for _, y in curve(root, 1)] == [(bottom + top) / 2] * 2
    words = [one.text for one in root.iter(f"{SVG}text")]
    assert {"AP50 1.000", "AP75 0.500", "AP 0.250", "minutes", "average precision", "0.5", "1.5", "2"} <= set(words)


def test_minutes_include_those_for_scenes() -> None:
    text = ap_plot([line(0, 0.0, None, scene_minutes=5.0), line(9, 5.0, 0.5, scene_minutes=5.0)])
    assert text is not None
    root = ET.fromstring(text)
    assert [x for x, _ in curve(root, 1)] == pytest.approx([44 + 170, 44 + 340])
    assert len(curve(root, 0)) == 1  # AP50 was not defined at first
    assert "minutes, with those for scenes" in [one.text for one in root.iter(f"{SVG}text")]


def test_without_an_evaluation_there_is_no_plot() -> None:
    assert ap_plot([{"step": 1, "minutes": 1.0}]) is None

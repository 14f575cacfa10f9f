"""Colours say which prediction is which part."""

from dataclasses import replace

import cv2
import numpy as np

from binpick_env.evaluation.segmentation.pictures import part_colours, prediction_colours, scene_panels, truth_colours
from binpick_env.evaluation.segmentation.record import STAGES, SceneRecord
from binpick_env.jobs.report_style import curves

GREY = np.array([105, 98, 92])
RED, WHITE = (50, 50, 235), (245, 245, 245)


def record(labels: list[int], ids: list[int], fractions: tuple[float, ...] = (0.9, 0.8, 0.05)) -> SceneRecord:
    """Return 10 points for each entry, side by side."""
    truth = np.repeat(np.array(ids, np.int64), 10)
    count = len(truth)
    found = np.repeat(np.array(labels, np.int64), 10)
    return SceneRecord(
        labels=found,
        scores=np.linspace(0.9, 0.5, found.max(initial=-1) + 1),
        instance_ids=truth,
        visible_fractions=np.array(fractions),
        pixels=np.column_stack([np.arange(count) + 100, np.full(count, 50)]).astype(np.int64),
        picture=np.full((20, count + 30), 77, np.uint8),
        corner=(90, 40),
        wrong_side=3,
        contour=40,
        ms=dict.fromkeys(STAGES, 1.0),
        threads=1,
        git_commit="",
    )


def test_a_prediction_has_the_colour_of_the_part_it_fits() -> None:
    scene = record(labels=[1, 1, 0, 0], ids=[0, 0, 1, 1])
    np.testing.assert_array_equal(prediction_colours(scene), truth_colours(scene))
    assert len(np.unique(prediction_colours(scene), axis=0)) == 2


def test_what_fits_no_part_is_striped() -> None:
    scene = record(labels=[0, 1, 2, 2], ids=[0, 0, 0, 1])  # two pieces and a mix, of IoU 1/3, 1/3 and 1/2 with part 1
    colours = {tuple(colour) for colour in prediction_colours(scene).tolist()}
    assert colours == {RED, WHITE}


def test_what_does_not_count_is_grey() -> None:
    scene = record(labels=[0, 1, 2, -1, 2], ids=[0, 2, -1, 1, -1])
    colours = prediction_colours(scene).reshape(5, 10, 3)
    np.testing.assert_array_equal(colours[0, 0], part_colours(3)[0])
    for k in range(1, 5):  # an uncounted part, the container, no label, the container
        np.testing.assert_array_equal(colours[k], np.broadcast_to(GREY, (10, 3)))
    truth = truth_colours(scene).reshape(5, 10, 3)
    np.testing.assert_array_equal(truth[1], np.broadcast_to(GREY, (10, 3)))
    np.testing.assert_array_equal(truth[2], truth[1])
    np.testing.assert_array_equal(truth[3, 0], part_colours(3)[1])


def test_panels_show_the_points_where_they_are() -> None:
    scene = record(labels=[0, 0], ids=[0, 1])
    panels = {panel.name: cv2.imdecode(np.frombuffer(panel.data, np.uint8), 1) for panel in scene_panels(scene)}
    assert list(panels) == ["image", "boundary points", "truth", "prediction"]
    for picture in panels.values():
        assert picture is not None
        assert picture.shape[:2] == (20, 50)
    truth = panels["truth"]
    assert truth is not None
    np.testing.assert_array_equal(truth[10, 10:20], np.broadcast_to(part_colours(1)[0], (10, 3)))
    assert (truth[9] == truth[0, 0]).all()
    bare = scene_panels(replace(scene, picture=np.zeros((0, 0), np.uint8)))
    assert [panel.name for panel in bare] == ["boundary points", "truth", "prediction"]
    alone = cv2.imdecode(np.frombuffer(bare[1].data, np.uint8), 1)
    assert alone is not None
    assert alone.shape[:2] == (1, 20)


def test_many_parts_have_colours_of_their_own() -> None:
    colours = part_colours(30).astype(int)
    apart = np.abs(colours[:, None] - colours[None]).sum(axis=2)[~np.eye(30, dtype=bool)]
    assert apart.min() > 5
    assert np.abs(colours - RED).sum(axis=1).min() > 40


def test_curves_go_up_where_values_rise() -> None:
    text = curves([("a & b", [(0.0, 0.0), (1.0, 1.0)])], "recall", "precision")
    assert "<polyline class='line-0' points='44.0,352.0 384.0,12.0'/>" in text
    assert "a &amp; b" in text
    assert text.count("<text") == 13

"""Pictures: each point has the colour of its instance, at its pixel."""

from dataclasses import replace

import cv2
import numpy as np

from binpick_env.evaluation.segmentation.pictures import (
    Colours,
    part_colours,
    prediction_colours,
    scene_panels,
    side_by_side,
    truth_colours,
)
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


def test_an_instance_without_a_part_is_striped() -> None:
    scene = record(labels=[0, 1, 2, 2], ids=[0, 0, 0, 1])  # two pieces and a mix, of IoU 1/3, 1/3 and 1/2 with part 1
    colours = {tuple(colour) for colour in prediction_colours(scene).tolist()}
    assert colours == {RED, WHITE}


def test_stripes_are_diagonal_and_six_pixels_of_the_picture_wide() -> None:
    rows, columns = np.mgrid[0:30, 0:40]
    scene = record(labels=[0] * 120, ids=[0] * 40 + [1] * 40 + [2] * 40, fractions=(0.9, 0.9, 0.9))
    scene = replace(scene, pixels=np.column_stack([columns.ravel(), rows.ravel()]), picture=np.zeros((0, 0), np.uint8))
    white = (prediction_colours(scene) == WHITE).all(axis=1).reshape(30, 40)
    np.testing.assert_array_equal(white, (rows + columns) // 6 % 2 == 1)
    # In an image of 1280 columns one pixel of the picture is two pixels of the camera.
    wide = replace(scene, picture=np.zeros((960, 1280), np.uint8))
    white = (prediction_colours(wide) == WHITE).all(axis=1).reshape(30, 40)
    np.testing.assert_array_equal(white, (rows + columns) // 12 % 2 == 1)


def test_stripes_cover_the_points_of_their_instance_alone() -> None:
    scene = record(labels=[0, 0, 1, 2, -1], ids=[0, 0, 1, 1, 0], fractions=(0.9, 0.9))  # 1 and 2 are halves of part 1
    striped = (prediction_colours(scene)[:, None] == [RED, WHITE]).all(axis=-1).any(axis=-1)
    np.testing.assert_array_equal(striped, np.repeat([False, False, True, True, False], 10))


def test_uncounted_parts_and_the_container_are_grey() -> None:
    scene = record(labels=[0, 1, 2, -1, 2], ids=[0, 2, -1, 1, -1])
    colours = prediction_colours(scene).reshape(5, 10, 3)
    np.testing.assert_array_equal(colours[0, 0], part_colours(3)[0])
    for k in range(1, 5):  # an uncounted part, the container, no label, the container
        np.testing.assert_array_equal(colours[k], np.broadcast_to(GREY, (10, 3)))
    truth = truth_colours(scene).reshape(5, 10, 3)
    np.testing.assert_array_equal(truth[1], np.broadcast_to(GREY, (10, 3)))
    np.testing.assert_array_equal(truth[2], truth[1])
    np.testing.assert_array_equal(truth[3, 0], part_colours(3)[1])


def decoded(data: bytes) -> Colours:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture.astype(np.uint8)


def test_panels_show_the_points_where_they_are() -> None:
    scene = record(labels=[0, 1], ids=[0, 0])
    panels = {panel.name: decoded(panel.data) for panel in scene_panels(scene)}
    assert list(panels) == ["image", "boundary points", "truth", "prediction"]
    for name, colours in (("truth", truth_colours(scene)), ("prediction", prediction_colours(scene))):
        assert panels[name].shape == (20, 50, 3)
        np.testing.assert_array_equal(panels[name][10, 10:30], colours)  # pixels (100, 50) on, seen from (90, 40)
        rest = np.delete(panels[name].reshape(-1, 3), 10 * 50 + np.arange(10, 30), axis=0)
        assert len(np.unique(rest, axis=0)) == 1
    dots = panels["boundary points"]
    assert (dots[10, 10:30] == dots[10, 10]).all()
    assert dots[10, 10].min() > 200
    assert dots[10, 9].max() < 40


def test_the_image_is_shown_as_it_was_kept() -> None:
    ramp = np.broadcast_to(np.linspace(20, 220, 50).astype(np.uint8), (20, 50))
    image = decoded(scene_panels(replace(record(labels=[0, 0], ids=[0, 1]), picture=ramp))[0].data)
    assert image.shape == (20, 50, 3)
    assert np.abs(image.astype(int) - ramp[:, :, None]).max() <= 6  # JPEG


def test_without_an_image_the_panels_end_at_the_points() -> None:
    bare = scene_panels(replace(record(labels=[0, 0], ids=[0, 1]), picture=np.zeros((0, 0), np.uint8)))
    assert [panel.name for panel in bare] == ["boundary points", "truth", "prediction"]
    assert decoded(bare[1].data).shape == (1, 20, 3)


def test_a_wide_image_is_shown_at_half_its_size() -> None:
    scene = replace(record(labels=[0, 0], ids=[0, 1]), picture=np.full((61, 641), 77, np.uint8))
    panels = {panel.name: decoded(panel.data) for panel in scene_panels(scene)}
    assert {picture.shape for name, picture in panels.items() if name != "image"} == {(31, 321, 3)}
    np.testing.assert_array_equal(panels["truth"][5, 5:15], truth_colours(scene)[::2])


def test_image_truth_and_prediction_stand_side_by_side_in_rgb() -> None:
    scene = record(labels=[0, 1], ids=[0, 0])
    image, truth, prediction = np.split(side_by_side(scene), 3, axis=1)
    assert (image == 77).all()
    np.testing.assert_array_equal(truth[10, 10:30, ::-1], truth_colours(scene))
    np.testing.assert_array_equal(prediction[10, 10:30, ::-1], prediction_colours(scene))
    bare = side_by_side(replace(scene, picture=np.zeros((0, 0), np.uint8)))
    np.testing.assert_array_equal(bare[0, :, ::-1], np.vstack([truth_colours(scene), prediction_colours(scene)]))


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

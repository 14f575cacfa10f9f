"""Appearances: the clean one changes nothing, each departure shows, and deviations keep their limit."""

import numpy as np
import pytest

from binpick_env.camera.appearance import Appearance, draw_appearance
from tests.binpick_env.camera.camera_scene import Scene
from tests.binpick_env.camera.camera_views import look


def test_the_clean_appearance_changes_no_bit(pile: Scene) -> None:
    plain, clean = look(pile, sensor="good"), look(pile, sensor="good", appearance=Appearance(seed=5))
    np.testing.assert_array_equal(plain.frame.grey, clean.frame.grey)
    np.testing.assert_array_equal(plain.frame.depth, clean.frame.depth)


@pytest.mark.parametrize(
    "change",
    [
        {"part_brightness": 0.5}, {"container_brightness": 0.5}, {"gradient": 0.5}, {"vignetting": 0.4}, {"blur": 1.0},
        {"specular": 0.5, "shininess": 2.0}, {"labelled": 1.0}, {"wear": 0.5}, {"noise": 3.0},
    ],
)  # fmt: skip
def test_each_departure_changes_the_grey_image_alone(pile: Scene, change: dict[str, float]) -> None:
    plain, other = look(pile, "raster"), look(pile, "raster", appearance=Appearance(**change))  # type: ignore[arg-type]
    assert (plain.frame.grey != other.frame.grey).mean() > 0.002
    np.testing.assert_array_equal(plain.depth_true, other.depth_true)
    np.testing.assert_array_equal(plain.instance_ids, other.instance_ids)
    assert np.all(other.frame.grey[other.depth_true == 0] == 0)


def test_deviations_stay_within_their_limit_and_keep_the_ids(pile: Scene) -> None:
    plain, other = look(pile, "raster"), look(pile, "raster", appearance=Appearance(deviation=0.0005))
    np.testing.assert_array_equal(plain.instance_ids, other.instance_ids)
    part = plain.instance_ids >= 0
    np.testing.assert_array_equal(plain.depth_true[~part], other.depth_true[~part])
    shift = np.abs(other.depth_true - plain.depth_true)[part]
    assert 1e-4 < shift.max() <= 0.0005 / 0.2 + 1e-6
    np.testing.assert_allclose(np.linalg.norm(other.normals[part], axis=1), 1.0, atol=1e-5)


def test_drawn_appearances_vary_and_are_reproducible() -> None:
    drawn = [draw_appearance(np.random.default_rng(seed)) for seed in range(40)]
    assert drawn == [draw_appearance(np.random.default_rng(seed)) for seed in range(40)]
    assert max(each.deviation for each in drawn) <= 0.0005
    assert max(each.blur for each in drawn) <= 1.2
    assert 0 < sum(each.part_brightness < 0.55 for each in drawn) < 25
    assert not any(each.is_clean for each in drawn)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"gradient": 2}, r"gradient must be in \[0, 1\], got 2"),
        ({"deviation": 0.1}, "deviation must be from 0 to 0.002, got 0.1"),
        ({"container_brightness": 3}, "container_brightness must be from 0 to 2, got 3"),
        ({"shininess": 0}, "shininess and wavelength must be positive, got 0 and 0.03"),
        ({"gradient_direction": np.inf}, "gradient_direction must be finite, got inf"),
    ],
)
def test_mistakes_are_named(values: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Appearance(**values)  # type: ignore[arg-type]

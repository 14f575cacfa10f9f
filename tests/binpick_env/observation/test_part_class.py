"""Classes of parts by hand: blocks whose axes are as their sides, and sizes at the limits."""

import numpy as np
import pytest
import trimesh

from binpick_env.config import CameraConfig
from binpick_env.observation.part_class import CLASSES, SIZE_LIMITS_PX, part_class, size_px
from perception.geometry import rotation_about
from perception.part import PartModel
from perception.shape import shape_signature


@pytest.mark.parametrize(
    ("sides", "shape"),
    [
        ((0.03, 0.03, 0.03), "compact"),
        ((0.03, 0.021, 0.015), "compact"),  # 0.70 and 0.71
        ((0.06, 0.05, 0.01), "flat"),  # 0.83 and 0.20
        ((0.01, 0.06, 0.05), "flat"),  # the order of the sides does not matter
        ((0.09, 0.02, 0.018), "slender"),  # 0.22 and 0.90
        ((0.09, 0.03, 0.02), "slender"),  # both ratios are small, that of the longest is smaller: 0.33 and 0.67
        ((0.09, 0.05, 0.01), "flat"),  # 0.56 and 0.20
    ],
)
def test_a_block_has_the_class_of_its_sides(sides: tuple[float, float, float], shape: str) -> None:
    box = trimesh.creation.box(sides)
    turn = np.eye(4)
    turn[:3, :3] = rotation_about((1.0, 2.0, 3.0), 0.7)
    box.apply_transform(turn)
    signature = shape_signature(PartModel.from_mesh("block", box))
    assert part_class(signature, 150.0).shape == shape


def test_a_cylinder_and_a_disc() -> None:
    """A solid of revolution has two equal axes; rounding must not make it another class."""
    for height, shape in ((0.1, "slender"), (0.035, "compact"), (0.004, "flat")):
        mesh = trimesh.creation.cylinder(radius=0.02, height=height)
        assert part_class(shape_signature(PartModel.from_mesh("turned", mesh)), 150.0).shape == shape


def test_sizes_are_lengths_in_the_image() -> None:
    signature = shape_signature(PartModel.from_mesh("cube", trimesh.creation.box((0.03, 0.03, 0.03))))
    small, medium = SIZE_LIMITS_PX
    assert part_class(signature, small).size == "small"
    assert part_class(signature, small + 1).size == part_class(signature, medium).size == "medium"
    assert part_class(signature, medium + 1).size == "large"
    assert size_px(0.09, CameraConfig()) == pytest.approx(240.0)
    assert size_px(0.09, CameraConfig(width=640, height=480, distance=0.45)) == pytest.approx(240.0)
    assert len(CLASSES) == 9

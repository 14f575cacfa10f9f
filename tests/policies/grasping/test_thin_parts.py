"""Grasps of a plate that lies on the floor, on either of its broad sides."""

import numpy as np
import pytest

from policies.grasping.gripper import PAD_SIZE
from policies.grasping.thin_parts import BroadSides
from tests.policies.grasp_cell import box

MARGIN = 0.001
THIN = 0.012
PLATE = box((0.08, 0.05, 0.006))
SIDES = BroadSides.of_thin_part(PLATE, THIN)
FIRST = np.array([[0.01, -0.025, 0.001], [0.01, 0.0, -0.003]])  # across the plate, and through its thickness
SECOND = np.array([[0.01, 0.025, 0.001], [0.01, 0.0, 0.003]])


def test_a_line_across_the_plate_gives_two_grasps_on_each_side():
    T, width = SIDES.grasps_off_the_floor(FIRST, SECOND, MARGIN)
    assert width == pytest.approx(np.full(4, 0.05))
    height = 0.003 + T[:, 2, 3] * -np.sign(T[:, 2, 2])  # of the fingertips above the side that the plate lies on
    assert sorted(np.round(1000 * height, 6)) == pytest.approx([1.3, 1.3, 2.8, 2.8])
    assert T[:, :2, 3] == pytest.approx(np.tile([0.01, 0.0], (4, 1)))
    assert np.abs(T[:, :3, 1]) == pytest.approx(np.tile([0.0, 1.0, 0.0], (4, 1)))
    assert sorted(T[:, 2, 2]) == pytest.approx([-1, -1, 1, 1])
    assert np.linalg.det(T[:, :3, :3]) == pytest.approx(np.ones(4))


def test_a_part_that_is_not_thin_has_none():
    block = BroadSides.of_thin_part(box((0.08, 0.05, 0.03)), THIN)
    T, width = block.grasps_off_the_floor(FIRST, SECOND, MARGIN)
    assert (T.shape, width.shape) == ((0, 4, 4), (0,))
    assert block.shallow(*SIDES.grasps_off_the_floor(FIRST, SECOND, MARGIN), MARGIN).tolist() == [0] * 4


def test_heights_above_the_floor_have_levels():
    T, width = SIDES.grasps_off_the_floor(FIRST, SECOND, MARGIN)
    assert sorted(SIDES.shallow(T, width, MARGIN)) == [1, 1, 2, 2]
    deep = T.copy()
    deep[:, :3, 3] += 0.0016 * T[:, :3, 2]
    assert sorted(SIDES.shallow(deep, width, MARGIN)) == [0, 0, 1, 1]


def test_a_leaning_jaw_reaches_lower_than_its_middle():
    T, width = SIDES.grasps_off_the_floor(FIRST, SECOND, MARGIN)
    lean = 0.1  # about the closing direction: one side of the pads goes down
    c, s = np.cos(lean), np.sin(lean)
    leaning = T @ np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])
    assert s * PAD_SIZE[0] / 2 > 0.001
    assert sorted(SIDES.shallow(leaning, width, MARGIN)) == [0, 0, 1, 1]

"""The score drop under perturbation, where the logit is a function of the pose made by hand."""

import numpy as np
import pytest

from perception.geometry import Floats, invert_transform, make_transform, rotation_about, rotation_angle
from perception.part import PartModel, Symmetry
from perception.pose.verification.perturbation import ANGLE, score_drop, small_rotations
from tests.perception.pose import posed_parts as pp
from tests.perception.pose.posed_parts import PARTS, Z, rod, wedge, wheel

HERE = pp.random_pose(np.random.default_rng(31))


@pytest.mark.parametrize("least", [0.0, 2.0])
@pytest.mark.parametrize("axis", range(3))
def test_the_smallest_drop_counts(axis: int, least: float) -> None:
    """It falls by 5 per radian about each principal axis, and less about one."""
    part = wedge()
    axes, falls = np.asarray(part.mesh.principal_inertia_vectors), np.full(3, 5.0)
    falls[axis] = least

    def logit(T: Floats) -> float:
        turn = (invert_transform(HERE) @ T)[:3, :3]
        turned = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        return 7.0 - float(falls @ np.abs(axes @ turned))

    assert score_drop(HERE, small_rotations(part), logit) == pytest.approx(least * np.sin(ANGLE), abs=1e-9)


def test_one_rotation_that_fits_better_makes_the_drop_negative() -> None:
    """The logit is the height of the part's x axis before the camera: one turn of a pair raises it."""
    part = wedge()
    turns = small_rotations(part)
    falls = [HERE[2, 0] - (HERE @ turn)[2, 0] for turn in turns]
    found = score_drop(HERE, turns, lambda T: float(T[2, 0]))
    assert found == pytest.approx(min(falls))
    assert found < 0 < max(falls)


def test_the_logit_is_computed_once_here_and_once_for_each_perturbation() -> None:
    asked: list[Floats] = []

    def logit(T: Floats) -> float:
        asked.append(T)
        return 0.0

    turns = small_rotations(wedge())
    assert score_drop(HERE, turns, logit) == 0.0
    np.testing.assert_array_equal(asked, [HERE, *(HERE @ turn for turn in turns)])


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.name)
def test_turns_keep_the_centre(part: PartModel) -> None:
    for turn in small_rotations(part):
        np.testing.assert_allclose(turn[:3, :3] @ part.centre + turn[:3, 3], part.centre, atol=1e-12)
        assert rotation_angle(turn[:3, :3]) == pytest.approx(ANGLE)


def test_a_part_without_symmetry_is_turned_both_ways_about_each_axis() -> None:
    part = wedge()
    turns = small_rotations(part)
    assert turns.shape == (6, 4, 4)
    axes = np.asarray(part.mesh.principal_inertia_vectors)
    for k, axis in enumerate([*axes, *-axes]):
        np.testing.assert_allclose(turns[k, :3, :3], rotation_about(axis, ANGLE), atol=1e-12)


@pytest.mark.parametrize("part", [wheel(), rod()], ids=["wheel", "rod"])
def test_a_solid_of_revolution_is_not_turned_about_its_axis(part: PartModel) -> None:
    turns = small_rotations(part)
    assert turns.shape == (4, 4, 4)
    np.testing.assert_allclose(turns[:, :3, :3] @ Z @ Z, np.cos(ANGLE))  # all of them tilt it


def test_without_perturbations_the_drop_is_infinite() -> None:
    axes = np.asarray(wedge().mesh.principal_inertia_vectors)
    ways = [rotation_about(axis, ANGLE) for axis in (*axes, *-axes)]
    part = PartModel.from_mesh("as good as a ball", wedge().mesh, Symmetry(rotations=np.array([np.eye(3), *ways])))
    assert small_rotations(part).shape == (0, 4, 4)
    assert score_drop(HERE, small_rotations(part), lambda T: float(T[0, 3])) == np.inf


@pytest.mark.parametrize(("degrees", "left"), [(6.5, 5), (5.5, 6)])
def test_a_turn_that_the_symmetry_all_but_undoes_is_none(degrees: float, left: int) -> None:
    """A turn by 8 deg is within 2 deg of the one that the symmetry has, or it is not."""
    axis = np.asarray(wedge().mesh.principal_inertia_vectors)[1]
    alike = Symmetry(rotations=np.array([np.eye(3), rotation_about(axis, np.deg2rad(degrees))]))
    assert len(small_rotations(PartModel.from_mesh("nearly", wedge().mesh, alike))) == left


def test_the_drop_is_the_same_in_another_frame() -> None:
    part, motion = wedge(), make_transform(rotation_about((1.0, 2.0, 3.0), 1.0), (0.1, 0.2, 0.3))

    def logit(T: Floats) -> float:
        return -float(np.abs(T[:3, :3] - HERE[:3, :3]) @ (1.0, 2.0, 3.0) @ (3.0, 1.0, 2.0))

    first = score_drop(HERE, small_rotations(part), logit)
    second = score_drop(motion @ HERE, small_rotations(part), lambda T: logit(invert_transform(motion) @ T))
    assert second == pytest.approx(first)
    assert first > 0

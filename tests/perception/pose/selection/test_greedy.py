"""Poses that collide, by hand: points on a line, of which two that are too near each other collide."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from perception.geometry import Floats, make_transform
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.greedy import select_poses
from perception.pose.verification.verification import Verdict

SURE = 0.5


VERDICT = Verdict(edge_score=0.0, explained=0.0, support=0.0, violation=0.0, measured=0.0, logit=0.0)


def at(x: float, score: float) -> PoseEstimate:
    """Return a pose on a line."""
    return PoseEstimate(
        T_cam_part=make_transform(translation=[x, 0.0, 0.0]),
        score=score,
        instance_idx=0,
        visible_fraction=0.0,
        verdict=VERDICT,
        margin=0.0,
        score_drop=0.0,
        size=0,
        surface_score=1.0,
    )


class Given:
    """A group's poses by their order here, best first; ``alone`` is the score of a pose that has no rival left."""

    def __init__(self, *poses: PoseEstimate, alone: float | None = None) -> None:
        self.left = list(poses)
        self.alone = alone
        self.asked = 0

    def best(self) -> PoseEstimate | None:
        self.asked += 1
        if not self.left:
            return None
        if len(self.left) == 1 and self.alone is not None:
            return replace(self.left[0], score=self.alone)
        return self.left[0]

    def rule_out(self, impossible: Callable[[Floats], bool]) -> bool:
        before = len(self.left)
        self.left = [pose for pose in self.left if not impossible(pose.T_cam_part)]
        return len(self.left) < before


def near(T_a: Floats, T_b: Floats) -> bool:
    """Whether two points are less than 1 apart."""
    return bool(np.abs(T_a[0, 3] - T_b[0, 3]) < 1)


def selected(*groups: Given, sure: float = SURE) -> list[tuple[float, float] | None]:
    return [None if pose is None else (pose.T_cam_part[0, 3], pose.score) for pose in select_poses(groups, near, sure)]


def test_nothing_is_selected_from_nothing() -> None:
    assert selected() == []
    assert selected(Given(), Given()) == [None, None]


def test_poses_apart_are_each_groups_best() -> None:
    first, second = Given(at(0, 0.6), at(9, 0.5)), Given(at(1, 0.9), at(8, 0.1))
    assert selected(first, second) == [(0, 0.6), (1, 0.9)]
    assert (first.asked, second.asked) == (1, 1)  # to choose anew costs time


@pytest.mark.parametrize("higher", [0, 1])
def test_the_pose_with_the_higher_score_is_selected_and_the_next_best_takes_the_place_of_the_other(higher: int) -> None:
    sure, other = Given(at(0, 0.9), at(5, 0.8)), Given(at(0.5, 0.7), at(0.9, 0.65), at(2, 0.3), at(3, 0.2))
    found = selected(*((sure, other) if higher == 0 else (other, sure)))
    assert found[higher] == (0, 0.9)
    assert found[1 - higher] == (2, 0.3)


def test_a_group_has_no_pose_when_all_are_ruled_out() -> None:
    assert selected(Given(at(0.5, 0.8), at(-0.5, 0.7)), Given(at(0, 0.9))) == [None, (0, 0.9)]


def test_the_score_of_a_pose_may_rise_as_its_rivals_are_ruled_out() -> None:
    """The second group's best falls; what is left of it has no rival and beats the third group's pose."""
    second = Given(at(0.5, 0.8), at(2, 0.4), alone=0.85)
    assert selected(Given(at(0, 0.9)), second, Given(at(2.5, 0.7))) == [(0, 0.9), (2, 0.85), None]


def test_a_pose_that_was_ruled_out_rules_nothing_out() -> None:
    """It would clash with the third group's pose, but was ruled out before its turn came."""
    found = selected(Given(at(0, 0.9)), Given(at(0.9, 0.8)), Given(at(1.8, 0.7), at(9, 0.1)))
    assert found == [(0, 0.9), None, (1.8, 0.7)]


def test_of_poses_with_equal_scores_the_first_is_selected() -> None:
    assert selected(Given(at(0, 0.8)), Given(at(0.5, 0.8)), Given(at(-0.5, 0.8))) == [(0, 0.8), None, None]
    assert selected(Given(at(0.5, 0.8)), Given(at(0, 0.8))) == [(0.5, 0.8), None]


def test_poses_with_a_low_score_rule_nothing_out() -> None:
    unsure = Given(at(0, 0.49)), Given(at(0.5, 0.48)), Given(at(0.5, 0.3))
    assert selected(*unsure) == [(0, 0.49), (0.5, 0.48), (0.5, 0.3)]
    assert selected(*unsure, sure=0.49) == [(0, 0.49), None, None]


def test_a_pose_rules_out_poses_with_a_low_score_but_those_do_not_rule_out_each_other() -> None:
    found = selected(Given(at(0.5, 0.2), at(3, 0.1)), Given(at(0, 0.9)), Given(at(3.5, 0.4)))
    assert found == [(3, 0.1), (0, 0.9), (3.5, 0.4)]


def test_no_pose_is_selected_from_a_group_that_is_left_empty() -> None:
    """With ``sure`` at 0 even a pose of score 0 stands, but None never does."""
    assert selected(Given(), Given(at(0, 0.0)), Given(at(0.5, 0.0)), sure=0.0) == [None, (0, 0.0), None]


def test_the_selected_pose_is_the_first_argument() -> None:
    asked: list[tuple[float, float]] = []

    def noted(T_a: Floats, T_b: Floats) -> bool:
        asked.append((T_a[0, 3], T_b[0, 3]))
        return near(T_a, T_b)

    select_poses([Given(at(4, 0.6), at(0.2, 0.5)), Given(at(0, 0.9))], noted, SURE)
    assert asked == [(0.0, 4.0), (0.0, 0.2)]

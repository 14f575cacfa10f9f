"""What the poses of plates side by side leave over of the groups that they were found in."""

from dataclasses import replace

import numpy as np
import pytest

from perception.boundary import BoundaryCloud
from perception.instance import Instance
from perception.pose.pose_estimate import PoseEstimate
from perception.pose.selection.leftovers import LeftoverConfig, leftover_groups
from perception.pose.verification.verification import Verdict
from tests.perception.pose.selection.test_explanation import NEXT, RIM, SURFACE, cloud, group, plate, rim

CONFIG = LeftoverConfig(min_points=40)
VERDICT = Verdict(edge_score=1.0, explained=1.0, support=1.0, violation=0.0, measured=1.0, logit=5.0)
PAIR = cloud(rim(0.0), rim(NEXT))  # two plates
BOTH = Instance(point_idx=np.arange(2 * RIM), score=0.7)


def estimate(x: float, score: float = 0.95) -> PoseEstimate:
    return PoseEstimate(
        T_cam_part=plate(x).T_cam_part,
        score=score,
        instance_idx=0,
        visible_fraction=1.0,
        verdict=VERDICT,
        margin=3.0,
        score_drop=3.0,
        size=50,
        surface_score=1.0,
    )


def left(boundary: BoundaryCloud, groups: list[Instance], *poses: PoseEstimate | None) -> list[list[int]]:
    return [one.point_idx.tolist() for one in leftover_groups(boundary, groups, poses, SURFACE, CONFIG)]


def test_the_second_part_of_a_group_is_left_over() -> None:
    assert left(PAIR, [BOTH], estimate(0.0)) == [list(range(RIM, 2 * RIM))]
    assert left(PAIR, [BOTH], estimate(NEXT)) == [list(range(RIM))]
    (found,) = leftover_groups(PAIR, [BOTH], [estimate(0.0)], SURFACE, CONFIG)
    assert found.score == BOTH.score


def test_a_part_that_another_group_explains_is_not_left_over() -> None:
    three = cloud(rim(0.0), rim(NEXT), rim(NEXT))
    groups = [BOTH, group(2 * RIM, 3 * RIM)]
    assert left(three, groups, estimate(0.0), estimate(NEXT)) == []


def test_a_group_of_one_part_leaves_nothing_over() -> None:
    assert left(PAIR, [group(0, RIM), group(RIM, 2 * RIM)], estimate(0.0), estimate(NEXT)) == []


@pytest.mark.parametrize("pose", [None, estimate(0.0, score=CONFIG.min_score - 0.01)])
def test_a_group_without_a_likely_pose_is_not_searched_again(pose: PoseEstimate | None) -> None:
    assert left(PAIR, [BOTH], pose) == []
    elsewhere = Instance(point_idx=np.arange(RIM, 2 * RIM), score=0.7)
    assert left(PAIR, [group(0, RIM), elsewhere], estimate(0.0), pose) == []


def test_small_remainders_are_noise() -> None:
    share, points = RIM / (2 * RIM), RIM
    for config, kept in (
        (replace(CONFIG, min_share=share), 1),
        (replace(CONFIG, min_share=share + 0.01), 0),
        (replace(CONFIG, min_points=points), 1),
        (replace(CONFIG, min_points=points + 1), 0),
    ):
        assert len(leftover_groups(PAIR, [BOTH], [estimate(0.0)], SURFACE, config)) == kept


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"min_score": 1.1}, r"min_score must be in \[0, 1\], got 1\.1"),
        ({"min_share": -0.1}, r"min_share must be in \[0, 1\], got -0\.1"),
        ({"min_points": 0}, "min_points must be at least 1, got 0"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LeftoverConfig(**changes)  # type: ignore[arg-type]

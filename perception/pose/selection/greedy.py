"""Greedy, collision-aware pose selection: where parts would overlap, the pose with the higher score is kept."""

from collections.abc import Callable, Sequence
from typing import Protocol

from perception.geometry import Floats
from perception.pose.pose_estimate import PoseEstimate


class PoseSource(Protocol):
    """The possible poses of one group of boundary points."""

    def best(self) -> PoseEstimate | None:
        """Return the best pose that is left, None if none is left."""
        ...

    def rule_out(self, impossible: Callable[[Floats], bool]) -> bool:
        """Remove the (4, 4) poses that are impossible; return whether there were any."""
        ...


def select_poses(
    groups: Sequence[PoseSource], collide: Callable[[Floats, Floats], bool], min_score: float
) -> list[PoseEstimate | None]:
    """Select one pose for each group, groups with the highest score first.

    A pose that reaches the score rules out the poses of all lower groups that collide with it. The next best pose of
    such a group may take its place, and its score may rise because fewer rivals are left.

    Args:
        groups: Possible poses of each group.
        collide: Whether two parts in the (4, 4) poses ``T_cam_part`` would collide; the first pose is selected.
        min_score: Score from which a pose rules out others, in [0, 1].

    Returns:
        The pose of each group; None where no pose is possible.

    Note:
        Deterministic: of groups with equal scores the first one is selected first.
    """
    poses = [group.best() for group in groups]
    remaining = list(range(len(groups)))
    while remaining:
        k = max(remaining, key=lambda j: _score(poses[j]))
        selected = poses[k]
        if selected is None or selected.score < min_score:
            break
        remaining.remove(k)
        T_cam_part = selected.T_cam_part
        for j in remaining:
            if groups[j].rule_out(lambda other, T=T_cam_part: collide(T, other)):  # type: ignore[misc]
                poses[j] = groups[j].best()
    return poses


def _score(pose: PoseEstimate | None) -> float:
    return -1.0 if pose is None else pose.score

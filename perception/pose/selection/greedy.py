"""Poses of many groups brought into agreement: where parts would share room, the surer pose stands."""

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from perception.geometry import Floats


class Posed(Protocol):
    """What is asked of a pose."""

    @property
    def T_cam_part(self) -> Floats:
        """(4, 4)."""
        ...

    @property
    def score(self) -> float:
        """How likely it is right, in [0, 1]."""
        ...


P = TypeVar("P", bound=Posed, covariant=True)


class Choice(Protocol[P]):
    """The poses that a group of points may have."""

    def best(self) -> P | None:
        """Return the likeliest of those left, None if none is left."""
        ...

    def rule_out(self, impossible: Callable[[Floats], bool]) -> bool:
        """Leave out the (4, 4) poses that are impossible; return whether there were any."""
        ...


def arrange(choices: Sequence[Choice[P]], clash: Callable[[Floats, Floats], bool], sure: float) -> list[P | None]:
    """Choose a pose for each group, the surest groups first.

    Every pose that is sure enough stands, and rules out all poses of groups less sure that clash with it. So a group's
    next best pose may take the place of its best one, and a pose may become surer as its rivals fall.

    Args:
        choices: Of each group.
        clash: Whether two (4, 4) ``T_cam_part`` cannot be true at once; the first one stands.
        sure: A pose with this score rules others out.

    Returns:
        A pose of each group, None where none was possible.

    Note:
        Deterministic: of equally sure groups the first comes first.
    """
    poses = [choice.best() for choice in choices]
    left = list(range(len(choices)))
    while left:
        k = max(left, key=lambda j: _score(poses[j]))
        standing = poses[k]
        if standing is None or standing.score < sure:
            break
        left.remove(k)
        T = standing.T_cam_part
        for j in left:
            if choices[j].rule_out(lambda other, T=T: clash(T, other)):  # type: ignore[misc]
                poses[j] = choices[j].best()
    return poses


def _score(pose: Posed | None) -> float:
    return -1.0 if pose is None else pose.score

"""What the robot touches."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RobotContact:
    """Contact of the robot with its surroundings.

    Attributes:
        force: Sum of the magnitudes of the contact forces [N].
        with_cell: Whether the robot touches the bin, the tray or the table.
        parts: Indices of the parts that the robot touches.
    """

    force: float
    with_cell: bool
    parts: frozenset[int]

"""How a part's file was read: its unit, its bodies and what was repaired."""

from dataclasses import dataclass
from typing import Literal

UnitOrigin = Literal["given", "named", "guessed"]  # by the caller, by the file, or from the part's size


@dataclass(frozen=True, kw_only=True)
class FileFacts:
    """How a part's file was read.

    Attributes:
        unit: Unit of the file's coordinates.
        unit_origin: Whether the caller gave the unit, the file names it, or it was guessed from the part's size.
        bodies: Number of bodies in the file; those that overlap or touch were united.
        origin: Position of the part frame's origin, the volume's centroid, in the file's frame [m].
        repairs: What was changed so that the mesh is closed and of a size that can be handled, one sentence for each.
    """

    unit: str
    unit_origin: UnitOrigin
    bodies: int = 1
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    repairs: tuple[str, ...] = ()

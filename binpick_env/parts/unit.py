"""The units that a mesh file's coordinates may be in; most formats name none."""

from typing import Literal, get_args

from perception.size import METRES as METRES

Unit = Literal["m", "mm", "cm", "inch"]


def check_unit(unit: str) -> str:
    """Return the unit's name.

    Raises:
        ValueError: There is no such unit.
    """
    if unit not in METRES:
        raise ValueError(f"unit must be one of {', '.join(get_args(Unit))}, got {unit!r}")
    return unit

"""The units that a mesh file's coordinates may be in; files name none."""

from typing import Literal, get_args

Unit = Literal["m", "mm", "cm", "inch"]
METRES: dict[str, float] = {"m": 1.0, "mm": 0.001, "cm": 0.01, "inch": 0.0254}  # length of one unit [m]


def check_unit(unit: str) -> str:
    """Return the unit's name.

    Raises:
        ValueError: There is no such unit.
    """
    if unit not in METRES:
        raise ValueError(f"unit must be one of {', '.join(get_args(Unit))}, got {unit!r}")
    return unit

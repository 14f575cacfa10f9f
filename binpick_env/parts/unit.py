"""The units that a mesh file's coordinates may be in; files name none."""

from typing import Literal

Unit = Literal["m", "mm", "cm", "inch"]
METRES: dict[str, float] = {"m": 1.0, "mm": 0.001, "cm": 0.01, "inch": 0.0254}  # length of one unit [m]

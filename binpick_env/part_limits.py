"""What a cell's bin and jaw cannot do with a part; perception takes parts of more sizes."""

import logging
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import trimesh

from binpick_env.config import GRIPPER_STROKE, BinConfig, CellConfig
from binpick_env.jobs.text_tables import counted
from binpick_env.parts.mesh_file import D_MAX
from binpick_env.parts.part import Part

log = logging.getLogger(__name__)
FILLING = 0.4  # largest volume of the parts' hulls in a full bin, as a share of the bin's: see `bin_capacity`
# What a heap up to twice the bin's height holds at most, as shares of the bin's volume: half of it is air between the
# hulls, unless parts lie in each other's hollows, when their own volume is what limits it.
HEAPED_HULLS, HEAPED_VOLUME = 1.0, 0.6
_POSE_ERROR = 0.005  # room for the pose's error on each side of a grasped part [m]


def check_part(part: Part, config: CellConfig) -> None:
    """Refuse a part from a file that is too small for the camera or too large for the bin.

    The log says, once for a part and a jaw, if no side of the part fits the jaw.

    Raises:
        ValueError: ``d_max`` is out of the cell's range.
    """
    if not part.sides:
        return  # drawn or generated for cells
    largest, d_max = largest_d_max(config.bin), part.model.d_max
    if not D_MAX[0] <= d_max <= largest:
        length, width, height = (f"{1000 * side:g}" for side in config.bin.inner_size)
        cannot = f"no pile of larger ones lies in a bin of {length} x {width} x {height} mm"
        if d_max < D_MAX[0]:
            cannot = "the camera sees too few points on a smaller one"
        raise ValueError(
            f"the largest diameter of {part.source} must be {D_MAX[0]} to {largest:.3g} m in this cell ({cannot}), got "
            f"{d_max:.4g} m, read as {part.unit}; --unit, in Python unit=, names another unit"
        )
    jaw = GRIPPER_STROKE if config.robot.jaw is None else config.robot.jaw
    _say_what_fits(part.source, round(1e3 * float(np.min(part.sides)), 1), round(1e3 * (jaw - 2 * _POSE_ERROR), 1))


def require_room(part: Part, config: BinConfig, count: int) -> None:
    """Refuse more parts than can be heaped on a bin.

    Raises:
        ValueError: There is no room for ``count`` parts; the message says for how many there is.
    """
    most = max(
        _number_in(part.model.mesh.convex_hull, config.inner_size, HEAPED_HULLS),
        _number_in(part.model.mesh, config.inner_size, HEAPED_VOLUME),
    )
    if count > most:
        length, width, height = (f"{1000 * side:g}" for side in config.inner_size)
        full = bin_capacity(part, config.inner_size)
        raise ValueError(
            f"{counted(count, 'part')} of d_max {1000 * part.model.d_max:.0f} mm do not fit into a bin of "
            f"{length} x {width} x {height} mm: it is full with {full}, and no more than {most} can be heaped on it; "
            "use fewer parts or a larger bin"
        )


def bin_capacity(part: Part, inner_size: Sequence[float]) -> int:
    """Return how many parts a bin holds, at least 1: the hulls of so many take `FILLING` of its volume.

    Args:
        part: Part that the bin is filled with.
        inner_size: Length, width and height inside the bin [m].
    """
    return _number_in(part.model.mesh.convex_hull, inner_size, FILLING)


def _number_in(mesh: trimesh.Trimesh, inner_size: Sequence[float], share: float) -> int:
    """Return how many solids take a share of a bin's volume, at least 1."""
    return max(1, int(share * np.prod(inner_size) / mesh.volume))


def largest_d_max(config: BinConfig) -> float:
    """Return the largest ``d_max`` of which a bin holds a pile [m]: 0.2 m for the standard bin, by its shorter side."""
    return D_MAX[1] * min(config.inner_size[:2]) / min(BinConfig().inner_size[:2])


@lru_cache(maxsize=256)
def _say_what_fits(source: str, smallest_mm: float, widest_mm: float) -> None:
    if smallest_mm > widest_mm:
        log.warning(
            "no side of %s is under %g mm (the smallest: %g mm): the jaw has little or no room for it",
            source,
            widest_mm,
            smallest_mm,
        )

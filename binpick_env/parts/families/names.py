"""Names of generated parts: ``generated:FAMILY:INDEX``, and with a range of sizes ``generated:FAMILY:INDEX:50-110``."""

import re
from dataclasses import dataclass

from binpick_env.parts.families.registry import FAMILIES, HELD_OUT_FAMILIES, TRAINING_FAMILIES
from binpick_env.parts.label import GENERATED
from binpick_env.parts.mesh_file import D_MAX

_PATTERN = re.compile(r"generated:(\w+):(\d+)(?::(\d+)-(\d+))?")


@dataclass(frozen=True, kw_only=True)
class GeneratedName:
    """What the name of a generated part says.

    Attributes:
        family: Name of the family.
        index: Number of the part within its family, from 0 on.
        d_max_range: Range from which ``d_max`` is drawn [m], of whole millimetres.
    """

    family: str
    index: int
    d_max_range: tuple[float, float] = D_MAX

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise ValueError(f"family must be one of {', '.join(FAMILIES)}, got {self.family!r}")
        if self.index < 0:
            raise ValueError(f"index must be at least 0, got {self.index}")
        low, high = self.d_max_range
        if not D_MAX[0] <= low < high <= D_MAX[1]:
            raise ValueError(f"d_max_range must rise within {D_MAX[0]} to {D_MAX[1]} m, got {self.d_max_range}")

        if any(abs(1000 * each - round(1000 * each)) > 1e-6 for each in self.d_max_range):
            raise ValueError(f"d_max_range must be of whole millimetres, got {self.d_max_range} m")

    def __str__(self) -> str:
        """Return the name; the range is left out where it is that of all parts."""
        plain = f"{GENERATED}{self.family}:{self.index}"
        if self.d_max_range == D_MAX:
            return plain
        low, high = (round(1000 * each) for each in self.d_max_range)
        return f"{plain}:{low}-{high}"


def is_generated(name: str) -> bool:
    """Tell whether a name is meant to be that of a generated part."""
    return name.startswith(GENERATED)


def parse_name(name: str) -> GeneratedName:
    """Return what the name of a generated part says.

    Raises:
        ValueError: The name has another form, or names a family, index or range that does not exist.
    """
    match = _PATTERN.fullmatch(name)
    if match is None:
        raise ValueError(
            f"a generated part is named generated:FAMILY:INDEX or generated:FAMILY:INDEX:LOW-HIGH (d_max in whole mm), "
            f"with a family of {', '.join(FAMILIES)}; got {name!r}"
        )
    family, index, low, high = match.groups()
    if low is None:
        return GeneratedName(family=family, index=int(index))
    d_max_range = int(low) / 1000, int(high) / 1000
    return GeneratedName(family=family, index=int(index), d_max_range=d_max_range)


def training_parts(count: int, d_max_range: tuple[float, float] = D_MAX) -> list[str]:
    """Return the names of ``count`` parts of the training families.

    Args:
        count: Number of parts. Each family gives as many as any other, or one more.
        d_max_range: Range from which ``d_max`` is drawn [m], of whole millimetres.

    Raises:
        ValueError: ``count`` is under 1, or the range is none of a part's sizes.
    """
    return _names(TRAINING_FAMILIES, count, d_max_range)


def held_out_parts(count: int, d_max_range: tuple[float, float] = D_MAX) -> list[str]:
    """Return the names of ``count`` parts of the held-out families; as :func:`training_parts` otherwise."""
    return _names(HELD_OUT_FAMILIES, count, d_max_range)


def _names(families: tuple[str, ...], count: int, d_max_range: tuple[float, float]) -> list[str]:
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    low, high = d_max_range
    places = (divmod(k, len(families)) for k in range(count))
    return [
        str(GeneratedName(family=families[at], index=index, d_max_range=(float(low), float(high))))
        for index, at in places
    ]

"""The units in which the numbers of a bin's size may be meant."""

from collections.abc import Iterable

from perception.size import METRES

LONGEST = (0.08, 1.5)  # range of the longest inner side of most bins [m]; a guess of the unit must lead there
_SHORTEST = 0.01  # inner side of no bin [m]
NAMES = {"m": "metres", "mm": "millimetres", "cm": "centimetres", "inch": "inches"}


def bin_units(numbers: Iterable[float]) -> dict[str, tuple[float, ...]]:
    """Return the sizes [m] that the inner sides of a bin may mean, by the name of the unit that makes them plausible.

    Args:
        numbers: Inner sides in an unknown unit.
    """
    sides = tuple(numbers)
    sizes = {NAMES[unit]: tuple(scale * side for side in sides) for unit, scale in METRES.items()}
    return {
        name: size for name, size in sizes.items() if LONGEST[0] <= max(size) <= LONGEST[1] and min(size) >= _SHORTEST
    }


def bin_words(numbers: Iterable[float], *, without: str, longest: float = LONGEST[1]) -> str:
    """Return what to type for the inner sides of a bin, for each unit that makes them plausible; empty for none.

    Args:
        numbers: Inner sides in an unknown unit.
        without: Name of the unit that they were taken in.
        longest: Length of the longest bin that can be meant [m].
    """
    return " or ".join(
        f"--bin {'x'.join(f'{1000 * side:.6g}' for side in size)} if {unit} were meant"
        for unit, size in bin_units(numbers).items()
        if unit != without and max(size) <= longest
    )

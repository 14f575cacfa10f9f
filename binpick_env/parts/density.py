"""The densities that a part may have."""

from numbers import Real

FILE_DENSITY = 2700.0  # density of a part from a file whose caller names none: aluminium [kg/m^3]
DENSITIES = (10.0, 25_000.0)  # from foam to just above osmium [kg/m^3]


def check_density(density: float) -> None:
    """Refuse a density [kg/m^3] that no material has.

    Raises:
        ValueError: It is out of range.
    """
    if not (isinstance(density, Real) and DENSITIES[0] <= density <= DENSITIES[1]):
        raise ValueError(
            f"density must be {DENSITIES[0]:g} to {DENSITIES[1]:g} kg/m^3 (aluminium: 2700), got {density!r}"
        )

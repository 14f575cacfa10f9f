"""The tolerances that the symmetry of a part's file may be detected with."""

from numbers import Real

LARGEST = 0.1  # [m]; half of the largest part


def check_symmetry_tolerance(tolerance: float) -> None:
    """Refuse a tolerance [m] of no meaning.

    Raises:
        ValueError: It is out of range.
    """
    if not (isinstance(tolerance, Real) and 0 < tolerance < LARGEST):
        raise ValueError(f"symmetry_tolerance must be over 0 and under {LARGEST} m, got {tolerance!r}")

"""The sizes of parts that perception takes, and what a size outside of them most likely means."""

METRES: dict[str, float] = {"m": 1.0, "mm": 0.001, "cm": 0.01, "inch": 0.0254}  # length of one unit [m]
D_MAX = (0.003, 1.0)  # range of d_max that perception takes [m]
PLAUSIBLE = (0.01, 0.25)  # range of d_max of most parts in bins [m]; a guess of the unit must lead there


def require_size(name: str, d_max: float) -> None:
    """Refuse a part whose size no camera over a bin is meant for.

    Args:
        name: Name of the part, for the message.
        d_max: Largest distance between two vertices [m].

    Raises:
        ValueError: ``d_max`` is outside of `D_MAX`; the message names the likely unit.
    """
    if D_MAX[0] <= d_max <= D_MAX[1]:
        return
    raise ValueError(
        f"the largest diameter of {name!r} must be {D_MAX[0]} to {D_MAX[1]:g} m, got {d_max:.3g} m{_likely_unit(d_max)}"
    )


def _likely_unit(d_max: float) -> str:
    """Return the explanation of a size that is no part's."""
    larger = [(name, d_max * scale) for name, scale in METRES.items() if name != "m"]
    smaller = [(name, d_max / scale) for name, scale in METRES.items() if name != "m"]
    for sizes, meaning in ((larger, "the mesh is probably in"), (smaller, "a mesh in metres was probably read as")):
        likely = [f"{name} ({size:.3g} m)" for name, size in sizes if PLAUSIBLE[0] <= size <= PLAUSIBLE[1]]
        if likely:
            return f": {meaning} {' or '.join(likely)}"
    return ": the mesh must be in metres"

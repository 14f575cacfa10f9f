"""The parts of the soak tests: those of the catalogue, and as many generated ones of families held out of training."""

CATALOGUE = ("tee", "bracket", "part_a", "part_b", "part_c")
UNSEEN = (
    "generated:handle:4:50-110",
    "generated:spur_gear:2:50-110",
    "generated:heat_sink:1:50-110",
    "generated:wing_nut:3:50-110",
    "generated:y_fitting:0:50-110",
)
PARTS = tuple(name for pair in zip(CATALOGUE, UNSEEN, strict=True) for name in pair)


def unit_name(part: str, number: int) -> str:
    """Return the name of a unit of work on a part, which is also that of its file."""
    return f"{number:05d}-{part.replace(':', '_')}"

"""The pieces that results are printed with: aligned columns, numbers that may be missing."""

from collections.abc import Sequence

WIDTH = 78  # of a result in the terminal


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Align rows of cells, the first column to the left, the others to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)


def percent(value: float | None) -> str:
    """Return a share in per cent, or a dash."""
    return "–" if value is None else f"{100 * value:.1f} %"


def number(value: float | None, digits: int) -> str:
    """Return a number, or a dash."""
    return "–" if value is None else f"{value:.{digits}f}"


def spread(interval: tuple[float, float] | None) -> str:
    """Return an interval of whole numbers, or a dash."""
    return "–" if interval is None else f"{interval[0]:.0f} to {interval[1]:.0f}"

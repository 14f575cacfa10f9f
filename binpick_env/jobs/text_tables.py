"""Format results for the terminal: aligned columns, and a dash for a missing number."""

from collections.abc import Sequence

WIDTH = 78  # width of a table in the terminal [characters]


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of cells as aligned text, the first column flush left, the others flush right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)


def percent(value: float | None) -> str:
    """Return a fraction in per cent, or a dash for None."""
    return "–" if value is None else f"{100 * value:.1f} %"


def number(value: float | None, digits: int) -> str:
    """Return a number with so many decimal places, or a dash for None."""
    return "–" if value is None else f"{value:.{digits}f}"


def fine(value: float | None) -> str:
    """Return a small positive quantity such as an error: two decimals below 1, and never 0 unless it is 0."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    if value < 0.01:
        return "< 0.01"
    return f"{value:.{2 if value < 1 else 1}f}"


def spread(interval: tuple[float, float] | None) -> str:
    """Return an interval of whole numbers, or a dash for None."""
    return "–" if interval is None else f"{interval[0]:.0f} to {interval[1]:.0f}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1: "1 bin", "20 bins"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"

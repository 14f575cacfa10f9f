"""What a recording for Rerun holds."""

from pathlib import Path

from rerun.chunk import RrdReader


def rows_of(path: Path) -> dict[str, int]:
    """Return the number of rows of each entity of a recording."""
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).store().stream().to_chunks():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    return rows

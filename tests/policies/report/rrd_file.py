"""The contents of a recording, read by Rerun's own reader."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader


class RrdFile:
    """Rows of entities, in the order of a timeline."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        assert len(reader.recordings()) == len(reader.blueprints()) == 1
        self.chunks = reader.store().stream().to_chunks()

    @property
    def entities(self) -> set[str]:
        return {chunk.entity_path for chunk in self.chunks if not chunk.entity_path.startswith("/__")}

    @property
    def timelines(self) -> set[str]:
        return {name for chunk in self.chunks for name in chunk.timeline_names}

    def static(self, entity: str, component: str) -> Any:
        """The one value of a component that never changes."""
        (value,) = self._cells(entity, component, None)
        return value[1]

    def rows(self, entity: str, component: str, timeline: str = "time") -> list[tuple[float, Any]]:
        """(time [s] or number, values) of each row that has the component; of equal ones the last written last."""
        return sorted(self._cells(entity, component, timeline), key=lambda row: row[0])

    def _cells(self, entity: str, component: str, timeline: str | None) -> list[tuple[float, Any]]:
        cells = []
        for chunk in self.chunks:
            batch = chunk.to_record_batch()
            static_or_on_it = chunk.is_static if timeline is None else timeline in chunk.timeline_names
            if chunk.entity_path != entity or component not in batch.schema.names or not static_or_on_it:
                continue
            at = np.zeros(len(batch)) if timeline is None else _numbers(batch.column(timeline))
            values = batch.column(component).to_pylist()
            cells += [(float(t), value) for t, value in zip(at, values, strict=True)]
        return cells


def _numbers(times: Any) -> Any:
    if pa.types.is_duration(times.type):
        return times.cast(pa.int64()).to_numpy() / 1e9
    return times.to_numpy()

"""What the files of a finished job say, bit for bit, without the times that no two runs have in common."""

import csv
import hashlib
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

# Fields of wall clock, and the command line, which names the folder; in JSON objects, tables and archives.
WALL_CLOCK = frozenset(
    {
        "command", "compute", "concurrent", "elapsed", "minutes", "mpph", "mpph_overlapped", "ms", "ms_per_group",
        "ms_per_scene", "ms_pose", "ms_trials", "render", "settle", "t_compute", "t_compute_s",
        "t_concurrent", "t_concurrent_s", "wall",
    }
)  # fmt: skip
_DRAWN = (".html", ".svg", ".png", ".zip")  # pages and pictures, which show times
_EVENTS = "events.out.tfevents"  # TensorBoard's, which hold times


def facts_of(folder: Path) -> dict[str, str]:
    """Return every value of the files in a folder by its place, such as "bin_0000.json: picks.0.width".

    Raises:
        ValueError: A file cannot be read.
        OSError: A file cannot be read.
    """
    found = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if path.suffix in _DRAWN or path.name.startswith(_EVENTS):
            continue
        for place, value in _values(path):
            found[f"{path.relative_to(folder)}: {place}"] = value
    return found


def differing(first: dict[str, str], second: dict[str, str]) -> list[str]:
    """Return the places where two jobs' files do not say the same, or where only one of them has a file."""
    return [place for place in sorted({*first, *second}) if first.get(place) != second.get(place)]


def _values(path: Path) -> Iterator[tuple[str, str]]:
    match path.suffix:
        case ".json":
            yield from _flat(json.loads(path.read_text(encoding="utf-8")))
        case ".jsonl":
            rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
            # A resumed training may log its last step again; readers take the last line of a step.
            yield from _flat({str(row.get("step", k)): row for k, row in enumerate(rows)})
        case ".csv":
            rows = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))
            yield from _flat(rows)
        case ".npz":
            with np.load(path, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files if name not in WALL_CLOCK}
            yield from ((name, f"{a.dtype}{a.shape} {_digest(a.tobytes())}") for name, a in arrays.items())
        case ".safetensors":
            yield from _tensor_file(path.read_bytes())
        case _:
            yield "bytes", _digest(path.read_bytes())


def _tensor_file(raw: bytes) -> Iterator[tuple[str, str]]:
    """Yield the values of a safetensors file's header, and a digest of its tensors."""
    size = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8 : 8 + size])
    for name, text in header.pop("__metadata__", {}).items():
        yield from _flat(json.loads(text) if text[:1] == "{" else text, name)
    yield from _flat(header, "tensors")
    yield "bytes of the tensors", _digest(raw[8 + size :])


def _flat(value: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """Yield the plain values of a nested one by their places."""
    if isinstance(value, dict):
        for name, each in value.items():
            if name not in WALL_CLOCK:
                yield from _flat(each, f"{place}.{name}" if place else str(name))
    elif isinstance(value, list):
        yield f"{place}.length", str(len(value))
        for k, each in enumerate(value):
            yield from _flat(each, f"{place}.{k}")
    else:
        yield place, repr(value)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()

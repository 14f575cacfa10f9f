"""What two finished jobs have in common: every bit but the times."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from perception.runtime.records import RecordFormat
from policies.soak.kill.facts import differing, facts_of

FORMAT = RecordFormat(kind="toy", version=1, remedy="play")


def write(folder: Path, *, wall: float, width: float = 0.03, tensor: float = 1.0) -> None:
    folder.mkdir()
    (folder / "bin.json").write_text(json.dumps({"picks": [{"width": width, "t_compute": wall}], "wall": wall}))
    (folder / "log.jsonl").write_text(f'{{"step": 1, "minutes": {wall}}}\n' * round(wall))
    (folder / "picks.csv").write_text(f"outcome,t_compute_s\ndelivered,{wall}\n")
    (folder / "report.html").write_text(f"it took {wall} s")
    FORMAT.save_arrays(folder / "scene.npz", {"points": np.full(3, width), "ms": np.array(wall)})
    FORMAT.save_tensors(folder / "net.safetensors", {"w": torch.tensor([tensor])}, {"elapsed": wall, "steps": 3})


def test_times_do_not_count(tmp_path: Path) -> None:
    write(tmp_path / "a", wall=1.0)
    write(tmp_path / "b", wall=2.0)
    a, b = facts_of(tmp_path / "a"), facts_of(tmp_path / "b")
    assert differing(a, b) == []
    assert a["bin.json: picks.0.width"] == "0.03"
    assert a["net.safetensors: record.steps"] == "3"


def test_every_other_bit_does(tmp_path: Path) -> None:
    write(tmp_path / "a", wall=1.0)
    write(tmp_path / "b", wall=1.0, width=np.nextafter(0.03, 1), tensor=2.0)
    (tmp_path / "b" / ".bin.json.17").write_text("{}")  # a draft
    places = differing(facts_of(tmp_path / "a"), facts_of(tmp_path / "b"))
    assert places == [
        ".bin.json.17: bytes",
        "bin.json: picks.0.width",
        "net.safetensors: bytes of the tensors",
        "scene.npz: points",
    ]


def test_half_a_file_cannot_be_read(tmp_path: Path) -> None:
    write(tmp_path / "a", wall=1.0)
    (tmp_path / "a" / "bin.json").write_text('{"picks": [')
    with pytest.raises(ValueError, match="Expecting value"):
        facts_of(tmp_path / "a")

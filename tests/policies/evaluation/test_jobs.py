"""The worker processes of an evaluation."""

import os
import signal
from pathlib import Path

import pytest

from policies.evaluation.bin_evaluation import BinError
from policies.evaluation.cell import Cell
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.records import BinRecord
from tests.policies.fake_cell import dice_cell


def killed_cell(config: EvaluationConfig) -> Cell:
    os.kill(os.getpid(), signal.SIGKILL)
    return dice_cell(config)


def test_a_killed_worker_is_reported(tmp_path: Path) -> None:
    job = Job(out=tmp_path, bins=3, workers=2)
    with pytest.raises(BinError, match=r"^a worker was killed, perhaps for want of memory; try fewer workers$"):
        run_job(EvaluationConfig(num_parts=(6, 6)), job, make_cell=killed_cell)
    assert list(tmp_path.glob("bin_*.json")) == []


def test_each_record_is_on_disk_when_it_is_reported(tmp_path: Path) -> None:
    on_disk: list[bool] = []

    def look(record: BinRecord) -> None:
        on_disk.append((tmp_path / f"bin_{record.index:04d}.json").exists())

    job = Job(out=tmp_path, bins=3, workers=2)
    records = run_job(EvaluationConfig(num_parts=(6, 6)), job, look, make_cell=dice_cell)
    assert on_disk == [True] * 3
    assert [record.index for record in records] == [0, 1, 2]

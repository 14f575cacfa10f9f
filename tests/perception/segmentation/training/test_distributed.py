"""Several processes that train together take the same step as one process with all their samples."""

import json
import sys
from pathlib import Path

from tests.policies.commands.command_calls import start

SCRIPT = Path(__file__).with_name("two_processes.py")


def test_gradients_of_two_processes_are_those_of_one_with_twice_the_batch(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    done = start([*command, str(SCRIPT), str(tmp_path / "found.json")], tmp_path, OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["without"] < 1e-5
    # Each process normalises its own samples: with BatchNorm the gradients are others.
    assert found["with"] > 0.01

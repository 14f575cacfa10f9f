"""Frames of two blocks and options of `binpick perceive` for them, and what it writes."""

import json
from pathlib import Path
from typing import Any

from tests.perception.block_scene import BIN, ELL, POSES, photographed
from tests.perception.pose.estimator_scene import quick_estimator

FRAME, EMPTY = photographed(*POSES), photographed()
ESTIMATOR = quick_estimator(ELL)
POSE = [f"{value:.12g}" for value in BIN.T_world_bin.ravel()]
IN_BIN = ["--part", "ell.stl", "--bin", "400x300x100", "--bin-pose", *POSE]


def frames_in(path: Path) -> list[dict[str, Any]]:
    content = json.loads(path.read_text())
    assert content["version"] == 1
    assert {"command", "git_commit", "versions", "unread"} <= set(content)
    frames: list[dict[str, Any]] = content["frames"]
    return frames

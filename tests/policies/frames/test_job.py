"""A frame whose picture cannot be drawn is told as a bad file is, and the others go on."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from perception.frame import Frame
from perception.geometry import camera_matrix
from policies.frames import FrameJob, FrameSource, perceive_frames


@pytest.mark.parametrize("error", [cv2.error("no such kernel"), ZeroDivisionError("division by zero")])
def test_a_picture_that_fails_does_not_stop_the_other_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(record: object) -> None:
        raise error

    frame = Frame(depth=np.zeros((8, 8), np.float32), K=camera_matrix(9.0, 8, 8), T_world_cam=np.eye(4))
    monkeypatch.setattr(FrameSource, "read", lambda source, path: (frame, None))
    monkeypatch.setattr("policies.frames.job.draw_poses", fail)
    perceiver: Any = SimpleNamespace(perceive=lambda frame: None)
    paths = (tmp_path / "a.png", tmp_path / "b.png")
    job = FrameJob(paths=paths, source=FrameSource(), overlay=tmp_path / "pictures")
    outcomes = list(perceive_frames(job, perceiver))
    assert [outcome.path for outcome in outcomes] == list(paths)
    assert all(outcome.values is None and outcome.lines == (str(error),) for outcome in outcomes)

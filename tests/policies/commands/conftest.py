"""The folder of frames that `binpick perceive` is tried on."""

from pathlib import Path
from types import SimpleNamespace

import pytest


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of two frames, where the part and its network are those of the blocks."""
    # Here, so that tests of other commands do not wait for the blocks' models.
    import binpick_env.parts
    from perception.capture import write_frame
    from perception.segmentation.predictor import SegmentationPredictor
    from policies.frames import frame_perceiver
    from tests.perception.block_scene import ELL, KnowingPredictor, true_groups
    from tests.policies.commands.perceive_calls import EMPTY, ESTIMATOR, FRAME

    def estimator(part: object, workspace: object) -> object:
        assert part is ELL
        monkeypatch.setattr(ESTIMATOR, "workspace", workspace)
        return ESTIMATOR

    part = SimpleNamespace(model=ELL, file=None)
    monkeypatch.setattr(binpick_env.parts, "load_part", lambda *_, **__: part, raising=False)
    monkeypatch.setattr(SegmentationPredictor, "from_file", lambda *_, **__: KnowingPredictor(true_groups))
    monkeypatch.setattr(frame_perceiver, "PoseEstimator", estimator)
    write_frame(FRAME, tmp_path / "full.npz")
    write_frame(EMPTY, tmp_path / "empty.json", scale=0.0001)
    return tmp_path

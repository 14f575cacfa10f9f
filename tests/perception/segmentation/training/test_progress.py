"""What a person sees of a training."""

import sys
from pathlib import Path

import pytest

from perception.segmentation.training.loop import StepRecord
from perception.segmentation.training.progress import EVERY, TrainingDisplay

LINE = {"step": 40, "minutes": 1.5, "losses": {}, "validation": {"ap50": 0.75}}


def steps(display: TrainingDisplay) -> None:
    for step in range(1, 2 * EVERY + 1):
        losses = {"pairs": 0.5, "total": 1.25}
        record = StepRecord(step=step, progress=step / 40, losses=losses, learning_rate=1e-3, norm=2.0, skipped=False)
        display.on_step(record)


def test_the_bar_shows_loss_and_step_and_an_evaluation_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with TrainingDisplay(tmp_path, tensorboard=False, leader=True) as display:
        steps(display)
        display.on_line(LINE)
    shown = capsys.readouterr()
    assert "loss=1.250" in shown.err
    assert "ap50 0.750" in shown.out
    assert "1.5 min" in shown.out
    assert list(tmp_path.iterdir()) == []


def test_processes_that_do_not_lead_are_silent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with TrainingDisplay(tmp_path, tensorboard=True, leader=False) as display:
        steps(display)
    assert capsys.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("default")  # of TensorBoard's own imports
def test_tensorboard_gets_the_curves(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    with TrainingDisplay(tmp_path, tensorboard=True, leader=True) as display:
        steps(display)
        display.on_line(LINE)
    events = accumulator.EventAccumulator(str(tmp_path)).Reload()
    assert {"loss/pairs", "loss/total", "learning_rate", "gradient_norm", "validation/ap50"} <= set(
        events.Tags()["scalars"]
    )
    assert [(event.step, event.value) for event in events.Scalars("loss/total")] == [(20, 1.25), (40, 1.25)]


def test_without_tensorboard_a_training_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with TrainingDisplay(tmp_path, tensorboard=True, leader=True) as display:
        steps(display)
    assert "they need the extra 'learn'" in caplog.text

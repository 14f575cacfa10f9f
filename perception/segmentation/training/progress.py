"""Display of a training: a progress bar, a line for each evaluation, and curves in TensorBoard."""

import logging
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from perception.segmentation.training.loop import StepRecord

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

_log = logging.getLogger(__name__)
EVERY = 20  # number of steps between points of the curves in TensorBoard


class TrainingDisplay:
    """Display of steps and evaluations; a process that does not lead shows nothing."""

    def __init__(self, out: Path, tensorboard: bool, leader: bool) -> None:
        """Prepare the display.

        Args:
            out: Folder of the events of TensorBoard.
            tensorboard: Whether to write events.
            leader: Whether this process leads.
        """
        shape = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"
        self._bar = tqdm(total=100, unit="%", disable=not leader, bar_format=shape)
        self._writer = _writer(out) if tensorboard and leader else None

    def __enter__(self) -> "TrainingDisplay":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()
        if self._writer is not None:
            self._writer.close()

    def on_step(self, record: StepRecord) -> None:
        """Show a step."""
        if self._bar.n == 0 and record.progress > 0:
            self._bar.initial = 100 * record.progress  # resumed: the time left follows from the new steps alone
        self._bar.n = 100 * record.progress
        self._bar.set_postfix(step=record.step, loss=f"{record.losses['total']:.3f}", refresh=False)
        self._bar.update(0)
        if self._writer is not None and record.step % EVERY == 0:
            for name, value in record.losses.items():
                self._writer.add_scalar(f"loss/{name}", value, record.step)
            self._writer.add_scalar("learning_rate", record.learning_rate, record.step)
            self._writer.add_scalar("gradient_norm", record.norm, record.step)

    def on_line(self, line: dict[str, Any]) -> None:
        """Show an evaluation, a line of the log."""
        found: dict[str, float] = line.get("validation") or {}
        text = "  ".join(f"{name} {value:.3f}" for name, value in found.items())
        tqdm.write(f"step {line['step']:>7}  {line['minutes']:6.1f} min  {text}")
        if self._writer is not None:
            for name, value in found.items():
                self._writer.add_scalar(f"validation/{name}", value, line["step"])


def _writer(out: Path) -> "SummaryWriter | None":
    """Return TensorBoard's writer, or None if its package, which an extra installs, is missing."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError:
        _log.warning("no TensorBoard curves: they need the extra 'learn' (pip install -e '.[learn]')")
        return None
    return SummaryWriter(str(out))

"""The evaluation as a pure function: one configuration and one index give one bin's record."""

import time
from collections.abc import Callable, Sequence

from perception.runtime.provenance import git_commit
from policies.evaluation.cell import Cell, CellCache, scripted_cell
from policies.evaluation.config import EvaluationConfig, bin_seed
from policies.evaluation.frame_record import FrameRecord, record_frame
from policies.evaluation.listeners import BinListener, Decision, ListenerGroup
from policies.evaluation.records import BinRecord
from policies.evaluation.undelivered import LossWatch, UndeliveredPart, left_parts
from policies.grasping.outcomes import PickResult
from policies.picking.episode import run_bin


class BinError(RuntimeError):
    """A bin could not be evaluated; the text names its index and seed."""


def evaluate_bin(
    config: EvaluationConfig,
    index: int,
    listeners: Sequence[BinListener] = (),
    on_pick: Callable[[PickResult], None] | None = None,
    cells: CellCache | None = None,
) -> BinRecord:
    """Pick one bin to its end.

    Args:
        config: All that the record's numbers depend on, apart from wall clock.
        index: Number of the bin in the evaluation, from 0.
        listeners: Pictures, films and recordings, for example; they follow this bin alone.
        on_pick: Called after each decision, for progress.
        cells: Keeps environment and picker between bins; without it the scripted cell is built, used and closed.

    Raises:
        BinError: Anything went wrong; the text names index and seed, the cause is attached.
    """
    try:
        if cells is not None:
            return _evaluate(config, index, listeners, on_pick, cells.cell(config))
        with CellCache(scripted_cell) as own:
            return _evaluate(config, index, listeners, on_pick, own.cell(config))
    except Exception as error:
        if cells is not None:
            cells.close()  # its state is unknown
        reason = " ".join(str(error).split())  # on one line
        seed = bin_seed(config.seed, index)
        raise BinError(f"bin {index} (seed {seed}) failed: {type(error).__name__}: {reason}") from error


def _evaluate(
    config: EvaluationConfig,
    index: int,
    listeners: Sequence[BinListener],
    on_pick: Callable[[PickResult], None] | None,
    cell: Cell,
) -> BinRecord:
    with ListenerGroup(cell.env, listeners) as group:
        recorder = _Recorder(cell, group)
        result = run_bin(cell.env, recorder, bin_seed(config.seed, index), on_pick)
        after = group.bin_ended()
        wall = time.perf_counter() - recorder.start - recorder.comparing - group.seconds
        undelivered = recorder.undelivered()
    return BinRecord.from_result(
        result,
        recorder.pictures,
        recorder.frames,
        config_hash=config.digest(),
        index=index,
        wall=wall,
        settle=recorder.settled - recorder.start,
        render=recorder.render,
        git_commit=git_commit(),
        before=recorder.before,
        after=after,
        undelivered=undelivered,
    )


class _Recorder:
    """A picker that passes decisions on, compares their frames with the ground truth and calls the listeners."""

    def __init__(self, cell: Cell, listeners: ListenerGroup) -> None:
        self._env, self._picker = cell
        self._listeners = listeners
        self.pictures: list[str] = []  # file name, or "", for each decision
        self.frames: list[FrameRecord] = []
        self.before = ""  # file name of the picture of the settled bin
        self.render = 0.0  # wall clock that frames took to render [s]
        self.comparing = 0.0  # wall clock spent on the comparison with the ground truth [s]
        self._frame_id = -1
        self._losses = LossWatch()
        self.start = self.settled = time.perf_counter()

    def reset(self) -> None:
        self.settled = time.perf_counter()
        self._count_frame()
        self._picker.reset()
        self.before = self._listeners.bin_settled()

    def pick(self) -> PickResult:
        env = self._env
        self._listeners.before_decision()
        self._count_frame()
        frame_record = self._record_frame()
        # Kept now: the next frame is taken during a pick.
        labelled_capture, observed = env.labelled_capture, env.observed
        self._losses.before(labelled_capture)
        result = self._picker.pick()
        self._losses.after(env.events, len(self.pictures))
        self._count_frame()
        decision = Decision(
            number=len(self.pictures),
            labelled_capture=labelled_capture,
            observed=observed,
            frame_record=frame_record,
            result=result,
        )
        self.pictures.append(self._listeners.after_decision(decision))
        return result

    def undelivered(self) -> tuple[UndeliveredPart, ...]:
        """Return the parts that were lost, and those that were left when the bin had ended."""
        env = self._env
        last = record_frame(env.frame_id, env.labelled_capture, env.observed)
        return (*self._losses.lost, *left_parts(env, self._picker, last))

    def _record_frame(self) -> FrameRecord:
        """Compare the present frame with the ground truth, each frame only once."""
        start, env = time.perf_counter(), self._env
        if not self.frames or self.frames[-1].frame_id != env.frame_id:
            self.frames.append(record_frame(env.frame_id, env.labelled_capture, env.observed))
        self.comparing += time.perf_counter() - start
        return self.frames[-1]

    def _count_frame(self) -> None:
        if self._env.frame_id != self._frame_id:
            self._frame_id = self._env.frame_id
            self.render += self._env.render_time

"""The map over bins: in this process or in many, resumable, one file a bin.

Today the processes are this machine's; another scheduler would map :func:`evaluate_bin` likewise, over (config, index).
"""

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from binpick_env.jobs.process_map import WorkerError, map_indices
from perception.runtime.files import json_text, write_atomically
from perception.runtime.records import RecordError
from perception.runtime.threads import one_core
from policies.evaluation.bin_evaluation import (
    BinError,
    CellMaker,
    CellShelf,
    EvaluationConfig,
    Extras,
    bin_seed,
    evaluate_bin,
    scripted_cell,
)
from policies.evaluation.records import BinRecord, load_record, record_path, save_record
from policies.grasping.outcomes import PickResult

_log = logging.getLogger(__name__)
CONFIG_FILE = "config.json"
_shelf = CellShelf(scripted_cell)  # of a worker process; it goes with the process


class FolderError(ValueError):
    """The output folder belongs to another evaluation."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """How an evaluation is carried out; none of it changes the records' numbers, wall clock aside.

    Attributes:
        out: Folder of the records; bins that lie there already are not computed again.
        bins: How many; more may be asked for later.
        workers: Processes; 1 computes in this one.
        pictures: Whether to keep pictures beside the records.
        video: mp4 file to film bin 0 into; that bin is then computed again.
        video_limit: Length of the film in simulated time [s].
        rerun: rrd file to record bin 0 into; that bin is then computed again.
        fresh: Compute every bin, those that lie there already too.
    """

    out: Path
    bins: int = 10
    workers: int = 1
    pictures: bool = True
    video: Path | None = None
    video_limit: float = 60.0
    rerun: Path | None = None
    fresh: bool = False

    def __post_init__(self) -> None:
        if self.bins < 1 or self.workers < 1:
            raise ValueError(f"bins and workers must be at least 1, got {self.bins} and {self.workers}")

    def extras(self, index: int) -> Extras:
        """Return what else is made of bin ``index``."""
        pictures = self.out if self.pictures else None
        if index != 0:
            return Extras(pictures=pictures)
        return Extras(pictures=pictures, video=self.video, video_limit=self.video_limit, rerun=self.rerun)


def run_job(
    config: EvaluationConfig,
    job: Job,
    on_bin: Callable[[BinRecord], None] | None = None,
    on_pick: Callable[[PickResult], None] | None = None,
    make_cell: CellMaker = scripted_cell,
    on_found: Callable[[Sequence[BinRecord]], None] | None = None,
) -> list[BinRecord]:
    """Return the records of all bins, in order; those that are missing are computed and kept one by one.

    Args:
        config: What the records depend on.
        job: How they are computed.
        on_bin: Called with each record as it comes, those found on disk first.
        on_pick: Called after each decision, with one worker only.
        make_cell: Builds environment and picker; must be importable by name for more than one worker.
        on_found: Called once with the records that are taken from the folder, if there are any.

    Raises:
        FolderError: The folder holds records of another configuration.
        BinError: A bin failed, or a worker was killed; every other bin that was finished is kept.
        KeyboardInterrupt: Every bin that was finished is kept.
    """
    claim_folder(config, job.out)
    found: dict[int, BinRecord] = {}
    for index in range(job.bins):
        to_show = index == 0 and (job.video is not None or job.rerun is not None)
        record = None if to_show or job.fresh else stored_record(config, index, job.out)
        if record is not None:
            found[index] = record
    if found and on_found is not None:
        on_found(list(found.values()))
    if on_bin is not None:
        for record in found.values():
            on_bin(record)
    missing = [index for index in range(job.bins) if index not in found]
    if job.workers > 1 and len(missing) > 1:
        fresh = _in_processes(config, job, missing, make_cell)
    else:
        fresh = _here(config, job, missing, on_pick, make_cell)
    for record in fresh:
        found[record.index] = record
        if on_bin is not None:
            on_bin(record)
    return [found[index] for index in range(job.bins)]


def claim_folder(config: EvaluationConfig, out: Path) -> None:
    """Note the configuration in the folder, or compare with the one that is noted there.

    Raises:
        FolderError: Another configuration is noted; the text names what differs.
    """
    note = out / CONFIG_FILE
    mine = {"hash": config.digest(), "config": asdict(config)}
    if note.exists():
        try:
            theirs = json.loads(note.read_text())
            if theirs["hash"] == mine["hash"]:
                return
            different = _differences(json.loads(json_text(mine["config"])), theirs["config"])
        except (ValueError, KeyError, TypeError, AttributeError):
            _log.warning("%s is damaged and is written anew", note)
        else:
            raise FolderError(
                f"{out} holds another evaluation ({different}); choose another folder with --out, or delete this one"
            )
    write_atomically(note, json_text(mine))


def _differences(mine: dict[str, object], theirs: dict[str, object]) -> str:
    names = sorted(name for name in {*mine, *theirs} if mine.get(name) != theirs.get(name))
    return ", ".join(f"{name}: {theirs.get(name)} there, {mine.get(name)} here" for name in names) or "the part's file"


def stored_record(config: EvaluationConfig, index: int, out: Path) -> BinRecord | None:
    """Return the whole record of bin ``index`` that lies in ``out``, or None."""
    path = record_path(out, index)
    if not path.exists():
        return None
    try:
        record = load_record(path)
    except RecordError as error:
        _log.warning("bin %d is computed again: %s", index, error)
        return None
    fits = (record.config_hash, record.index, record.seed) == (config.digest(), index, bin_seed(config.seed, index))
    return record if fits else None


def _here(
    config: EvaluationConfig,
    job: Job,
    missing: list[int],
    on_pick: Callable[[PickResult], None] | None,
    make_cell: CellMaker,
) -> Iterator[BinRecord]:
    with CellShelf(make_cell) as shelf:
        for index in missing:
            with one_core():
                record = evaluate_bin(config, index, job.extras(index), on_pick, shelf)
            save_record(record, job.out)
            yield record


def _in_processes(config: EvaluationConfig, job: Job, missing: list[int], make_cell: CellMaker) -> Iterator[BinRecord]:
    try:
        yield from map_indices(partial(_work, config, job), missing, job.workers, _start_worker, (make_cell,))
    except WorkerError as error:
        raise BinError(str(error)) from error


def _work(config: EvaluationConfig, job: Job, index: int) -> BinRecord:
    record = evaluate_bin(config, index, job.extras(index), None, _shelf)
    save_record(record, job.out)
    return record


def _start_worker(make_cell: CellMaker) -> None:
    """Keep one cell for all bins of this process."""
    global _shelf
    _shelf = CellShelf(make_cell)

"""The map over bins: in this process, in several or on a cluster, resumable, one file per bin."""

import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path

from binpick_env.jobs.process_map import map_indices
from binpick_env.jobs.workers import Cluster, WorkerError, Workers, is_positive
from perception.runtime.file_work import FolderWork
from perception.runtime.files import json_text, write_atomically
from perception.runtime.records import RecordError
from perception.runtime.threads import one_core
from policies.evaluation.bin_evaluation import BinError, evaluate_bin
from policies.evaluation.cell import CellCache, CellFactory, scripted_cell
from policies.evaluation.conditions import flat_settings
from policies.evaluation.config import EvaluationConfig, bin_seed
from policies.evaluation.listeners import BinListener, ListenerFactory
from policies.evaluation.records import BinRecord, load_record, record_path, save_record
from policies.grasping.outcomes import PickResult

_log = logging.getLogger(__name__)
CONFIG_FILE = "config.json"
_cells = CellCache(scripted_cell)  # a worker process's; the cell is closed with the process


class FolderError(ValueError):
    """The output folder belongs to another evaluation."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """How an evaluation is carried out; nothing here changes the records' numbers, apart from wall clock.

    Attributes:
        out: Folder of the records; bins whose records it holds already are not computed again.
        bins: Number of bins; a later job in the same folder may ask for more.
        workers: Number of processes, of which 1 is this one, or a cluster.
        fresh: Whether every bin is computed, even if its record exists already.
        listeners: Makes the listeners that follow each bin, such as pictures; None for none.
    """

    out: Path
    bins: int = 10
    workers: Workers = 1
    fresh: bool = False
    listeners: ListenerFactory | None = None

    def __post_init__(self) -> None:
        if self.bins < 1 or not is_positive(self.workers):
            raise ValueError(f"bins and workers must be at least 1, got {self.bins} and {self.workers}")

    def bin_listeners(self, index: int) -> Sequence[BinListener]:
        """Return new listeners for bin ``index``."""
        return () if self.listeners is None else self.listeners.listeners(index, self.out)

    def must_compute(self, index: int) -> bool:
        """Return whether bin ``index`` is computed even if its record exists already."""
        return self.fresh or (self.listeners is not None and self.listeners.needs_bin(index))


def run_job(
    config: EvaluationConfig,
    job: Job,
    on_bin: Callable[[BinRecord], None] | None = None,
    on_pick: Callable[[PickResult], None] | None = None,
    make_cell: CellFactory = scripted_cell,
    on_found: Callable[[Sequence[BinRecord]], None] | None = None,
) -> list[BinRecord]:
    """Return the records of all bins, in order; missing ones are computed, each is written when it is finished.

    Args:
        config: All that the records' numbers depend on.
        job: How the records are computed, and the folder that they are kept in.
        on_bin: Called with each record, first with those that exist already.
        on_pick: Called after each decision of bins that are picked in this process.
        make_cell: Builds environment and picker; it must be importable by name if there are several workers.
        on_found: Called once with the records that exist already, if there are any.

    Raises:
        FolderError: The folder holds records of another configuration.
        BinError: A bin failed, or a worker was killed; the records of finished bins are kept.
        KeyboardInterrupt: The run was interrupted; the records of finished bins are kept.
    """
    ensure_folder_config(config, job.out)
    found: dict[int, BinRecord] = {}
    for index in range(job.bins):
        record = None if job.must_compute(index) else stored_record(config, index, job.out)
        if record is not None:
            found[index] = record
    if found and on_found is not None:
        on_found(list(found.values()))
    if on_bin is not None:
        for record in found.values():
            on_bin(record)
    missing = [index for index in range(job.bins) if index not in found]
    here = _picked_here(job, missing)
    elsewhere = [index for index in missing if index not in here]
    fresh = (_here(config, job, here, on_pick, make_cell), _in_processes(config, job, elsewhere, make_cell))
    for record in chain.from_iterable(fresh):
        found[record.index] = record
        if on_bin is not None:
            on_bin(record)
    return [found[index] for index in range(job.bins)]


def ensure_folder_config(config: EvaluationConfig, out: Path) -> None:
    """Write the configuration into the folder, or compare it with the one that is there.

    Raises:
        FolderError: The folder has another configuration, or its bins were segmented by another network; the message
            lists the differences.
    """
    path = out / CONFIG_FILE
    network = config.weights()
    given = {"hash": config.digest(), "config": asdict(config), "weights": network}
    if path.exists():
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
            different = _other_network(network, stored.get("weights"))
            if stored["hash"] == given["hash"] and different is None:
                return
            different = different or _differences(json.loads(json_text(given["config"])), stored["config"])
        except (ValueError, KeyError, TypeError, AttributeError):
            _log.warning("%s is damaged and is written anew", path)
        else:
            raise FolderError(
                f"{out} holds another evaluation ({different}); choose another folder with --out, or delete this one"
            )
    write_atomically(path, json_text(given))


def _other_network(given: dict[str, str] | None, stored: dict[str, str] | None) -> str | None:
    """Return how two networks differ; None if they do not, or if one is not known, as in folders of older versions."""
    if given is None or stored is None or given["sha256"] == stored["sha256"]:
        return None
    there, here = (f"{each['name']} ({each['sha256'][:8]})" for each in (stored, given))
    return f"weights: {there} there, {here} here"


def _differences(given: Mapping[str, object], stored: Mapping[str, object]) -> str:
    given, stored = flat_settings(given), flat_settings(stored)
    names = sorted(name for name in {*given, *stored} if given.get(name) != stored.get(name))
    return ", ".join(f"{name}: {stored.get(name)} there, {given.get(name)} here" for name in names) or "the part's file"


def stored_record(config: EvaluationConfig, index: int, out: Path) -> BinRecord | None:
    """Return the record of bin ``index`` in folder ``out``, None if there is none that is complete and fits."""
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


def _picked_here(job: Job, missing: list[int]) -> list[int]:
    """Return the bins that this process picks: on a cluster those that are filmed, since films are written here."""
    if isinstance(job.workers, Cluster):
        return [index for index in missing if job.listeners is not None and job.listeners.needs_bin(index)]
    return missing if job.workers == 1 or len(missing) < 2 else []


def _here(
    config: EvaluationConfig,
    job: Job,
    missing: list[int],
    on_pick: Callable[[PickResult], None] | None,
    make_cell: CellFactory,
) -> Iterator[BinRecord]:
    with CellCache(make_cell) as cells:
        for index in missing:
            with one_core():
                record = evaluate_bin(config, index, job.bin_listeners(index), on_pick, cells)
            save_record(record, job.out)
            yield record


def _in_processes(
    config: EvaluationConfig, job: Job, missing: list[int], make_cell: CellFactory
) -> Iterator[BinRecord]:
    if not missing:
        return
    try:
        work = FolderWork(partial(_work, config, job), job.out)
        yield from map_indices(work, missing, job.workers, _start_worker, (make_cell,))
    except WorkerError as error:
        raise BinError(str(error)) from error


def _work(config: EvaluationConfig, job: Job, folder: Path, index: int) -> BinRecord:
    record = evaluate_bin(config, index, replace(job, out=folder).bin_listeners(index), None, _cells)
    save_record(record, folder)
    return record


def _start_worker(make_cell: CellFactory) -> None:
    """Prepare the worker process: one cell serves all of its bins."""
    global _cells
    _cells = CellCache(make_cell)

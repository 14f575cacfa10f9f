"""The end of a job: records become JSON, pages and the text that is printed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from binpick_env.config import Perception
from perception.runtime.files import write_atomically
from policies.evaluation.budget import Runs, make_budget, save_budget
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import Summary, save_summary, summarise
from policies.evaluation.tables import result_table
from policies.report.budget_report import budget_table, write_budget_report
from policies.report.pick_csv import picks_csv
from policies.report.report import write_report

PICKS_FILE = "picks.csv"  # all decisions, in the job's folder


def conclude(
    records: Sequence[BinRecord],
    config: EvaluationConfig,
    job: Job,
    *,
    numbers: Path | None = None,
    html: bool = True,
    archive: bool = False,
) -> str:
    """Write an evaluation's numbers and its page; return the text to print.

    Args:
        records: Records of all bins, in order.
        config: Configuration that the records were made with.
        job: Job that made the records.
        numbers: JSON file to write the numbers to; None writes ``results.json`` in the job's folder.
        html: Whether ``report.html`` is written into the job's folder.
        archive: Whether the page, the CSV file, the numbers and pictures beside the page are packed into
            ``report.zip``, too.
    """
    numbers = numbers or job.out / "results.json"
    summary, packed = _write(records, config, job, numbers, html)
    lines = [result_table(summary), *_files(numbers, job.out / "report.html" if html else None)]
    lines.append(f"picks     {job.out / PICKS_FILE}")
    if archive:
        lines.append(f"archive   {_pack(job.out, packed, numbers)}")
    return "\n".join(lines)


def conclude_budget(
    records: Mapping[Perception, Sequence[BinRecord]],
    runs: Runs,
    job: Job,
    *,
    numbers: Path | None = None,
    html: bool = True,
    archive: bool = False,
) -> str:
    """Write the numbers and pages of three evaluations and of their comparison; return the text to print.

    Args:
        records: Records of the same bins, by perception.
        runs: The evaluations, as `policies.evaluation.budget.budget_jobs` returns them.
        job: Job that the evaluations were made from; its folder holds theirs.
        numbers: JSON file to write the comparison to; None writes ``budget.json`` in the job's folder.
        html: Whether the pages are written into the folders.
        archive: Whether all pages, CSV files, the numbers and pictures beside a page are packed into ``report.zip``,
            too.
    """
    numbers = numbers or job.out / "budget.json"
    modes, packed = {}, []
    for mode, run in runs.items():
        modes[mode], files = _write(records[mode], *run, run[1].out / "results.json", html)
        packed += files
    budget = make_budget(records, modes, np.random.default_rng(next(iter(modes.values())).seed))
    save_budget(numbers, budget)
    page = job.out / "budget.html" if html else None
    if page is not None:
        write_budget_report(page, budget)
        packed.append(page)
    lines = [budget_table(budget), *_files(numbers, page)]
    if archive:
        lines.append(f"archive   {_pack(job.out, packed, numbers)}")
    return "\n".join(lines)


def _write(
    records: Sequence[BinRecord], config: EvaluationConfig, job: Job, numbers: Path, html: bool
) -> tuple[Summary, list[Path]]:
    """Write an evaluation's files; return its summary and those files that an archive takes beside the numbers."""
    summary = summarise(records, config, np.random.default_rng(config.seed))
    save_summary(numbers, summary)
    write_atomically(job.out / PICKS_FILE, picks_csv(records))
    files = [job.out / PICKS_FILE]
    if html:
        linked = write_report(job.out / "report.html", summary, records, job.out)
        files += [job.out / "report.html", *(job.out / name for name in linked)]
    return summary, files


def _pack(folder: Path, files: Sequence[Path], numbers: Path) -> Path:
    """Pack files of a folder, and the numbers wherever they are, into its ``report.zip``; return the archive's path."""
    path = folder / "report.zip"
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, file.relative_to(folder))
        archive.write(numbers, numbers.name)
    return path


def _files(numbers: Path, page: Path | None) -> list[str]:
    return [f"numbers   {numbers}", *([] if page is None else [f"report    {page}"])]

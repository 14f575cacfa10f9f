"""The end of a job: records become JSON, pages and the text that is printed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from binpick_env.config import Perception
from policies.evaluation.budget import Runs, make_budget, save_budget
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import Summary, save_summary, summarise
from policies.evaluation.tables import result_table
from policies.report.budget_report import budget_table, write_budget_report
from policies.report.report import write_report


def conclude(
    records: Sequence[BinRecord],
    config: EvaluationConfig,
    job: Job,
    *,
    numbers: Path | None = None,
    html: bool = True,
) -> str:
    """Write an evaluation's numbers and its page; return the text to print.

    Args:
        records: Records of all bins, in order.
        config: Configuration that the records were made with.
        job: Job that made the records.
        numbers: JSON file to write the numbers to; None writes ``results.json`` in the job's folder.
        html: Whether ``report.html`` is written into the job's folder.
    """
    numbers = numbers or job.out / "results.json"
    summary = _write(records, config, job, numbers, html)
    return "\n".join([result_table(summary), *_files(numbers, job.out / "report.html" if html else None)])


def conclude_budget(
    records: Mapping[Perception, Sequence[BinRecord]],
    runs: Runs,
    job: Job,
    *,
    numbers: Path | None = None,
    html: bool = True,
) -> str:
    """Write the numbers and pages of three evaluations and of their comparison; return the text to print.

    Args:
        records: Records of the same bins, by perception.
        runs: The evaluations, as `policies.evaluation.budget.budget_jobs` returns them.
        job: Job that the evaluations were made from; its folder holds theirs.
        numbers: JSON file to write the comparison to; None writes ``budget.json`` in the job's folder.
        html: Whether the pages are written into the folders.
    """
    numbers = numbers or job.out / "budget.json"
    modes = {mode: _write(records[mode], *run, run[1].out / "results.json", html) for mode, run in runs.items()}
    budget = make_budget(records, modes, np.random.default_rng(next(iter(modes.values())).seed))
    save_budget(numbers, budget)
    page = job.out / "budget.html" if html else None
    if page is not None:
        write_budget_report(page, budget)
    return "\n".join([budget_table(budget), *_files(numbers, page)])


def _write(records: Sequence[BinRecord], config: EvaluationConfig, job: Job, numbers: Path, html: bool) -> Summary:
    summary = summarise(records, config, np.random.default_rng(config.seed))
    save_summary(numbers, summary)
    if html:
        write_report(job.out / "report.html", summary, records, job.out)
    return summary


def _files(numbers: Path, page: Path | None) -> list[str]:
    return [f"numbers   {numbers}", *([] if page is None else [f"report    {page}"])]

"""The end of a job: records become files, and the text that is printed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from binpick_env.config import Perception
from policies.evaluation.bin_evaluation import EvaluationConfig
from policies.evaluation.budget import Runs, make_budget, save_budget
from policies.evaluation.jobs import Job
from policies.evaluation.records import BinRecord
from policies.evaluation.summary import Summary, save_summary, summarise
from policies.evaluation.tables import result_table
from policies.report.budget_report import budget_table, write_budget_report
from policies.report.report import write_report


def conclude(records: Sequence[BinRecord], config: EvaluationConfig, job: Job, numbers: Path | None = None) -> str:
    """Write an evaluation's numbers, and its page if it has pictures; return what is to be printed.

    Args:
        records: Of all bins, in order.
        config: Theirs.
        job: How they were made.
        numbers: File of the numbers; ``results.json`` in the job's folder unless given.
    """
    numbers = numbers or job.out / "results.json"
    return "\n".join([result_table(_keep(records, config, job, numbers)), *_files(job, numbers, "report.html")])


def conclude_budget(
    records: Mapping[Perception, Sequence[BinRecord]], runs: Runs, job: Job, numbers: Path | None = None
) -> str:
    """Write the numbers and pages of three evaluations and of what lies between them; return what is to be printed.

    Args:
        records: Of the same bins, by perception.
        runs: The evaluations; see `policies.evaluation.budget.budget_jobs`.
        job: The whole.
        numbers: File of the comparison; ``budget.json`` in the job's folder unless given.
    """
    numbers = numbers or job.out / "budget.json"
    modes = {mode: _keep(records[mode], *run, run[1].out / "results.json") for mode, run in runs.items()}
    budget = make_budget(records, modes, np.random.default_rng(next(iter(modes.values())).seed))
    save_budget(numbers, budget)
    if job.pictures:
        write_budget_report(job.out / "budget.html", budget)
    return "\n".join([budget_table(budget), *_files(job, numbers, "budget.html")])


def _keep(records: Sequence[BinRecord], config: EvaluationConfig, job: Job, numbers: Path) -> Summary:
    summary = summarise(records, config, np.random.default_rng(config.seed))
    save_summary(numbers, summary)
    if job.pictures:
        write_report(job.out / "report.html", summary, records, job.out)
    return summary


def _files(job: Job, numbers: Path, page: str) -> list[str]:
    return [f"numbers   {numbers}", *([f"report    {job.out / page}"] if job.pictures else [])]

"""Two builds do the same work on the same inputs in turn: times, memory, and whether their results are equal."""

import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.jobs.text_tables import columns
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, machine, versions
from policies.benchmarks.builds.inputs import BuildJob, save_inputs
from policies.benchmarks.builds.paired import PairedTimes
from policies.benchmarks.builds.process import BuildProcess, require_checkout

HERE = Path(__file__).resolve().parents[3]
NEW_PROCESSES = 3  # number of processes of each build whose first result is timed


@dataclass(frozen=True, kw_only=True)
class BuildComparison:
    """Result of a comparison; "before" is the other build, "after" this one.

    Attributes:
        job: What was compared.
        rows: Wall clock and processor time of the work, of its stages that both builds tell, and of the first result of
            a new process, its start included.
        same: Number of inputs on which both results are equal bit for bit.
        facts: What the results were, before and after, for each input: poses, pixels, an outcome.
        memory_ready: Peak memory of both processes once everything was imported and prepared [MB].
        memory_peak: Peak memory of both processes [MB].
        commits: Commits of both builds; "" for a folder without a history.
    """

    job: BuildJob
    rows: tuple[PairedTimes, ...]
    same: int
    facts: tuple[tuple[Any, Any], ...]
    memory_ready: tuple[float, float]
    memory_peak: tuple[float, float]
    commits: tuple[str, str]

    def __str__(self) -> str:
        """Return the table of times and memory, and how many results are equal."""
        cells: list[tuple[str, ...]] = [("", "before", "after", "ratio", "95 %", "n")]
        for row in self.rows:
            numbers = (f"{np.median(row.before):.4g}", f"{np.median(row.after):.4g}", f"{row.ratio:.2f}")
            interval = "–" if row.interval is None else "{:.2f} to {:.2f}".format(*row.interval)
            cells.append((f"{row.name} [{row.unit}]", *numbers, interval, str(len(row.before))))
        for name, pair in (("memory, ready [MB]", self.memory_ready), ("memory, peak [MB]", self.memory_peak)):
            cells.append((name, *(f"{value:.0f}" for value in pair), f"{pair[0] / pair[1]:.2f}", "", ""))
        n = len(self.facts)
        said = [" ".join(str(pair[side]) for pair in self.facts) for side in (0, 1)]
        table = columns(cells)
        return f"{table}\nequal results   {self.same} of {n}\nresults before  {said[0]}\nresults after   {said[1]}"


def compare_builds(
    against: Path, job: BuildJob, here: Path = HERE, progress: Callable[[int], None] | None = None
) -> BuildComparison:
    """Do a job in another build and in this one.

    Args:
        against: Checkout of the other build.
        job: The work and its inputs.
        here: Checkout of this build.
        progress: Is told the number of inputs that both builds have done.

    Raises:
        ValueError: A folder is no checkout, a build has no such interface, or there is no such part.
        RuntimeError: A build failed, or a pile did not come to rest.

    Note:
        The builds take turns, the other one first, and each computes alone. Each does the first input once more before
        it is timed, which compiles kernels. New processes are started at the end, when these are kept on disk.
    """
    for checkout in (against, here):
        require_checkout(checkout)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        inputs = Path(folder) / "inputs.npz"
        save_inputs(inputs, job)
        builds = [stack.enter_context(BuildProcess(each, job.work, job.arguments(inputs))) for each in (against, here)]
        for build in builds:
            build.work(0)
        pairs: list[list[dict[str, Any]]] = []
        for k in range(job.repeats):
            pairs.append([build.work(k) for build in builds])
            if progress is not None:
                progress(k + 1)
        before, after = (build.finish() for build in builds)
        firsts = [[_first_result(each, job, inputs) for each in (against, here)] for _ in range(NEW_PROCESSES)]
        ready = (builds[0].imported, builds[1].imported)
    return BuildComparison(
        job=job,
        rows=(*_rows(job.work, pairs), _first_row(firsts)),
        same=sum(a["digest"] == b["digest"] for a, b in pairs),
        facts=tuple((a["fact"], b["fact"]) for a, b in pairs),
        memory_ready=ready,
        memory_peak=(before, after),
        commits=(commit_of(against), commit_of(here)),
    )


def _rows(work: str, pairs: list[list[dict[str, Any]]]) -> list[PairedTimes]:
    """Return the times of the work, and of the stages that both builds report for every input."""
    stages = [name for name in pairs[0][0]["stages"] if all(name in each["stages"] for pair in pairs for each in pair)]
    names = {"wall": f"{work}, wall clock", "cpu": f"{work}, processor"} | {name: f"  {name}" for name in stages}

    def times(key: str, side: int) -> tuple[float, ...]:
        told = (pair[side] for pair in pairs)
        return tuple(float(each[key] if key in ("wall", "cpu") else each["stages"][key]) for each in told)

    return [PairedTimes(name=name, unit="ms", before=times(key, 0), after=times(key, 1)) for key, name in names.items()]


def _first_result(checkout: Path, job: BuildJob, inputs: Path) -> float:
    """Return the time from the start of a process to its first result [ms]."""
    started = time.perf_counter()
    with BuildProcess(checkout, job.work, job.arguments(inputs)) as build:
        build.work(0)
        return 1000 * (time.perf_counter() - started)


def _first_row(pairs: list[list[float]]) -> PairedTimes:
    before, after = zip(*pairs, strict=True)
    return PairedTimes(name="first result of a new process", unit="ms", before=before, after=after)


def commit_of(checkout: Path) -> str:
    """Return the commit of a checkout, with ``-dirty`` if files were changed; "" for a folder without a history."""
    if not (checkout / ".git").exists():
        return ""
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def save_comparison(path: Path, comparison: BuildComparison) -> None:
    """Write a comparison as JSON, with machine, versions, commits and command; ratios and intervals are in its rows."""
    rows = [{**asdict(row), "ratio": row.ratio, "interval": row.interval} for row in comparison.rows]
    facts = {"benchmark": comparison.job.work, "machine": machine(), "command": command_line(), "versions": versions()}
    write_atomically(path, json_text({**facts, **asdict(comparison), "rows": rows}))

"""Evaluation of selectors: all pick the same bins, and their deliveries are compared bin by bin."""

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.jobs.text_tables import columns, counted
from perception.geometry import Floats
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, versions
from policies.evaluation.cell import Cell, make_env
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.records import BinRecord
from policies.evaluation.statistics import Rate, paired_ratio_difference, rate
from policies.grasping.outcomes import GraspOutcome
from policies.picking.scripted import ScriptedPicker
from policies.selection.hindsight import HINDSIGHT, HindsightPicker, HindsightTally, hindsight_tally
from policies.selection.selectors import SELECTORS, SelectorPicker, load_selector, selector_path

Records = dict[str, list[BinRecord]]  # records of the bins in order, by name of the selector
Gap = tuple[float, float, float]  # difference of two rates, and the ends of its 95 % interval


def selector_cell(spec: str, config: EvaluationConfig) -> Cell:
    """Build a cell in which a selector or hindsight chooses.

    Args:
        spec: Name of a heuristic or of a shipped selector, path to a trained one, or `HINDSIGHT`.
        config: Settings of cell and picker; nothing is pushed or put back.
    """
    env = make_env(config)
    picker = ScriptedPicker(env, config.picker.attempts_only())
    if spec == HINDSIGHT:
        return Cell(env, HindsightPicker(env, picker))
    return Cell(env, SelectorPicker(env, load_selector(spec), picker))


def selector_names(specs: Sequence[str]) -> dict[str, str]:
    """Return a unique name for each selector; that of a trained one contains a hash of its file.

    Args:
        specs: Names of heuristics or of shipped selectors, paths to trained ones, or `HINDSIGHT`.

    Raises:
        ValueError: A selector is given twice, or does not exist.
    """
    names = {}
    for spec in specs:
        if spec in (*SELECTORS, HINDSIGHT):
            names[spec] = spec
            continue
        path = selector_path(spec, HINDSIGHT)
        names[spec] = f"{path.stem}-{hashlib.sha256(path.read_bytes()).hexdigest()[:8]}"
    if len(set(names.values())) != len(specs):
        raise ValueError(f"every selector may be evaluated once, got {', '.join(specs)}")
    return names


def evaluate_selectors(
    config: EvaluationConfig,
    job: Job,
    specs: Sequence[str],
    on_bin: Callable[[str, BinRecord], None] | None = None,
    make_cell: Callable[[str, EvaluationConfig], Cell] = selector_cell,
) -> Records:
    """Let every selector pick the same bins, each into a folder of its own; bins that have a record are not repeated.

    Args:
        config: Settings of cell and picker, seed included.
        job: Folder, number of bins and number of processes.
        specs: Names of heuristics or of shipped selectors, paths to trained ones, or `HINDSIGHT` for the upper bound.
        on_bin: Callback with the name of a selector and each of its records.
        make_cell: Function that builds the cell of a selector.

    Raises:
        ValueError: A selector does not exist, or is given twice.
        FolderError: The folder holds an evaluation with another configuration.
        BinError: A bin failed; all other finished bins are kept.
    """
    records = {}
    for spec, name in selector_names(specs).items():
        notify = partial(on_bin, name) if on_bin is not None else None
        own = replace(job, out=job.out / name)
        records[name] = run_job(config, own, notify, make_cell=partial(make_cell, spec))
    return records


@dataclass(frozen=True, kw_only=True)
class SelectorResult:
    """Rates of a selector over all bins, and their differences from those of the best heuristic.

    Attributes:
        dr: Delivery rate, parts delivered of parts settled, pooled over bins.
        gsr: Grasp success rate, deliveries of attempts, pooled over bins.
        bins: Number of bins.
        dr_gap: DR minus that of the best heuristic, paired by bins; None for that heuristic itself.
        gsr_gap: GSR minus that of the best heuristic, paired by bins; None for that heuristic itself.
        reached: Gain in DR over the best heuristic, as a share of hindsight's gain; None without hindsight, or if the
            interval of hindsight's gain includes 0.
        tally: Counts of the decisions of hindsight; None for other selectors.
    """

    dr: Rate
    gsr: Rate
    bins: int
    dr_gap: Gap | None = None
    gsr_gap: Gap | None = None
    reached: float | None = None
    tally: HindsightTally | None = None


def compare_selectors(records: Records, seed: int = 0) -> tuple[str, dict[str, SelectorResult]]:
    """Return the name of the heuristic with the best DR, and the results of all selectors compared with it.

    Args:
        records: Records of the same bins for each selector; hindsight is no heuristic.
        seed: Seed of the bootstrap over bins.

    Raises:
        ValueError: There is no heuristic among the selectors, or their bins differ.
    """
    heuristics = _heuristics(records)
    if len({tuple(record.seed for record in own) for own in records.values()}) > 1:
        raise ValueError("the selectors were not evaluated on the same bins")
    plain = {name: _result(own) for name, own in records.items()}
    best = max(heuristics, key=lambda name: plain[name].dr.value or 0.0)
    compared = {best: plain[best]}
    for name, own in records.items():
        if name == best:
            continue
        rng = np.random.default_rng(seed)
        compared[name] = replace(
            plain[name],
            dr_gap=paired_ratio_difference(_deliveries(own), _deliveries(records[best]), rng),
            gsr_gap=paired_ratio_difference(_successes(own), _successes(records[best]), rng),
        )
    return best, _with_shares_of_bound(compared, records)


def selector_table(best: str, results: dict[str, SelectorResult]) -> str:
    """Return all results as text, the best DR first; with hindsight, also the share of its gain that each reached."""
    bound = results.get(HINDSIGHT)
    rows: list[tuple[str, ...]] = [("selector", "DR", "95 %", "GSR", "95 %", "n", "DR gap", "GSR gap")]
    order = sorted(results, key=lambda name: -(results[name].dr.value or 0.0))
    for name in order:
        own = results[name]
        shares = (cell for each in (own.dr, own.gsr) for cell in (_percent(each.value), _span(each.low, each.high)))
        gaps = tuple("best heuristic" if gap is None else _gap(gap) for gap in (own.dr_gap, own.gsr_gap))
        rows.append((f"{name} (bound)" if name == HINDSIGHT else name, *shares, str(own.gsr.n), *gaps))
    if bound is not None:
        reached = ["" if (share := results[name].reached) is None else f"{100 * share:.0f} %" for name in order]
        rows = [(*row, cell) for row, cell in zip(rows, ["of the bound", *reached], strict=True)]
    bins = results[best].bins
    meaning = f"gaps in points to {best}, paired bootstrap over bins, 95 %; n attempts"
    text = f"{columns(rows)}\n{counted(bins, 'bin')}; {meaning}"
    if bound is None:
        return text
    return f"{text}\nof the bound: share of the DR that hindsight gains over {best}\n{bound.tally}"


def save_selector_results(
    path: Path, config: EvaluationConfig, best: str, results: dict[str, SelectorResult], records: Records
) -> None:
    """Write the results with their configuration and provenance as JSON."""
    facts: dict[str, Any] = {"best_heuristic": best, "seed": config.seed, "config": asdict(config)}
    facts["selectors"] = {
        name: {
            "dr": own.dr.value,
            "gsr": own.gsr.value,
            "delivered": own.dr.successes,
            "parts_total": own.dr.n,
            "successes": own.gsr.successes,
            "attempts": own.gsr.n,
            "bins": own.bins,
            "intervals": {"dr": (own.dr.low, own.dr.high), "gsr": (own.gsr.low, own.gsr.high)},
            "dr_gap": own.dr_gap,
            "gsr_gap": own.gsr_gap,
            "reached": own.reached,
        }
        for name, own in results.items()
    }
    bound = results.get(HINDSIGHT)
    facts["hindsight"] = None if bound is None or bound.tally is None else asdict(bound.tally)
    commits = sorted({record.git_commit for own in records.values() for record in own})
    facts |= {"command": command_line(), "git_commits": commits, "versions": versions()}
    write_atomically(path, json_text(facts))


def check_comparable(specs: Sequence[str]) -> None:
    """Refuse selectors that could be evaluated but not compared, before any bin is picked.

    Args:
        specs: Names of heuristics or of shipped selectors, paths to trained ones, or `HINDSIGHT`.

    Raises:
        ValueError: A selector is given twice or does not exist, or there is no heuristic among them.
    """
    _heuristics(selector_names(specs))


def _heuristics(names: Iterable[str]) -> list[str]:
    """Return the heuristics among names of selectors; there has to be one."""
    found = [name for name in names if name in SELECTORS]
    if not found:
        raise ValueError(f"a heuristic is needed to compare with: one of {', '.join(SELECTORS)}")
    return found


def _result(records: Sequence[BinRecord]) -> SelectorResult:
    delivered, parts = _deliveries(records).sum(axis=0).astype(int)
    successes, attempts = _successes(records).sum(axis=0).astype(int)
    return SelectorResult(
        dr=rate(int(delivered), int(parts)), gsr=rate(int(successes), int(attempts)), bins=len(records)
    )


def _with_shares_of_bound(compared: dict[str, SelectorResult], records: Records) -> dict[str, SelectorResult]:
    """Add each selector's gain in DR as a share of hindsight's, provided that the latter is significant."""
    bound = compared.get(HINDSIGHT)
    if bound is None:
        return compared
    compared = compared | {HINDSIGHT: replace(bound, tally=hindsight_tally(records[HINDSIGHT]))}
    gain, low, _ = bound.dr_gap or (0.0, 0.0, 0.0)
    if not low > 0:
        return compared
    own_gains = {name: 0.0 if own.dr_gap is None else own.dr_gap[0] for name, own in compared.items()}
    return {name: replace(own, reached=own_gains[name] / gain) for name, own in compared.items()}


def _deliveries(records: Sequence[BinRecord]) -> Floats:
    return np.array([(record.delivered, record.parts_total) for record in records], dtype=np.float64)


def _successes(records: Sequence[BinRecord]) -> Floats:
    delivered = [sum(pick.outcome is GraspOutcome.DELIVERED for pick in record.attempts) for record in records]
    return np.array([(n, len(record.attempts)) for n, record in zip(delivered, records, strict=True)], dtype=np.float64)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _span(low: float, high: float) -> str:
    return f"{100 * low:.1f} to {100 * high:.1f}"


def _gap(gap: Gap) -> str:
    value, low, high = (100 * each for each in gap)
    return f"{value:+.1f} ({low:+.1f} to {high:+.1f})"

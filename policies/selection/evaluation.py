"""Selectors on the same bins: each picks all of them, and what they deliver is compared bin by bin."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.jobs.text_tables import columns
from perception.geometry import Floats
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, versions
from policies.evaluation.cell import Cell, watched_env
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job, run_job
from policies.evaluation.records import BinRecord
from policies.evaluation.statistics import Rate, paired_ratio_difference, rate
from policies.grasping.outcomes import GraspOutcome
from policies.picking.scripted import ScriptedPicker
from policies.selection.hindsight import HINDSIGHT, HindsightPicker, HindsightTally, hindsight_tally
from policies.selection.selectors import SELECTORS, SelectorPicker, load_selector, selector_path

Records = dict[str, list[BinRecord]]  # by the selector's name, bins in order
Gap = tuple[float, float, float]  # difference of two rates with its 95 % interval


def selector_cell(spec: str, config: EvaluationConfig) -> Cell:
    """Build a cell in which a selector chooses, or hindsight.

    Args:
        spec: Name of a heuristic, path to a trained selector, or `HINDSIGHT`.
        config: Of the cell.
    """
    env = watched_env(config)
    if spec == HINDSIGHT:
        return Cell(env, HindsightPicker(env, ScriptedPicker(env, config.picker)))
    return Cell(env, SelectorPicker(env, load_selector(spec), ScriptedPicker(env, config.picker)))


def selector_names(specs: Sequence[str]) -> dict[str, str]:
    """Return for each selector's spec a name of its own: a trained one's has its file's contents in it.

    Raises:
        ValueError: A selector is asked for twice, or there is none such.
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
    """Let every selector pick the same bins; each has a folder of its own, and what lies there is not computed again.

    Args:
        config: Part, perception, sensor, fill and seed.
        job: Folder, number of bins, processes.
        specs: Names of heuristics, paths to trained selectors, `HINDSIGHT` for the bound.
        on_bin: Called with a selector's name and each of its records.
        make_cell: Builds the cell of a selector.

    Raises:
        ValueError: There is no such selector, or one is asked for twice.
        FolderError: The folder holds an evaluation of another configuration.
        BinError: A bin failed; every other one that was finished is kept.
    """
    records = {}
    for spec, name in selector_names(specs).items():
        tell = partial(on_bin, name) if on_bin is not None else None
        own = replace(job, out=job.out / name)
        records[name] = run_job(config, own, tell, make_cell=partial(make_cell, spec))
    return records


@dataclass(frozen=True, kw_only=True)
class Standing:
    """How a selector did.

    Attributes:
        dr: Parts delivered of those settled, pooled.
        gsr: Attempts that delivered, pooled.
        bins: How many.
        dr_gap: DR minus the best heuristic's, paired by bins; None for that heuristic itself.
        gsr_gap: Likewise the GSR.
        reached: Share of hindsight's gain in DR over the best heuristic that is this one's; None without hindsight, or
            where the interval of that gain reaches down to 0.
        tally: What its decisions came to, for hindsight itself.
    """

    dr: Rate
    gsr: Rate
    bins: int
    dr_gap: Gap | None = None
    gsr_gap: Gap | None = None
    reached: float | None = None
    tally: HindsightTally | None = None


def compare_selectors(records: Records, seed: int = 0) -> tuple[str, dict[str, Standing]]:
    """Return the best heuristic by DR, and every selector's standing against it; hindsight is none of them.

    Args:
        records: Of the same bins.
        seed: Of the bootstrap over bins.

    Raises:
        ValueError: There is no heuristic among them, or their bins are not the same.
    """
    heuristics = [name for name in records if name in SELECTORS]
    if not heuristics:
        raise ValueError(f"a heuristic is needed to compare with: one of {', '.join(SELECTORS)}")
    if len({tuple(record.seed for record in own) for own in records.values()}) > 1:
        raise ValueError("the selectors were not evaluated on the same bins")
    plain = {name: _standing(own) for name, own in records.items()}
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
    return best, _against_the_bound(compared, records)


def standings_table(best: str, standings: dict[str, Standing]) -> str:
    """Return all standings as text, the best DR first; with hindsight, which share of its gain each has reached."""
    bound = standings.get(HINDSIGHT)
    rows: list[tuple[str, ...]] = [("selector", "DR", "95 %", "GSR", "95 %", "n", "DR gap", "GSR gap")]
    order = sorted(standings, key=lambda name: -(standings[name].dr.value or 0.0))
    for name in order:
        own = standings[name]
        shares = (cell for each in (own.dr, own.gsr) for cell in (_percent(each.value), _span(each.low, each.high)))
        gaps = tuple("best heuristic" if gap is None else _gap(gap) for gap in (own.dr_gap, own.gsr_gap))
        rows.append((f"{name} (bound)" if name == HINDSIGHT else name, *shares, str(own.gsr.n), *gaps))
    if bound is not None:
        reached = ["" if (share := standings[name].reached) is None else f"{100 * share:.0f} %" for name in order]
        rows = [(*row, cell) for row, cell in zip(rows, ["of the bound", *reached], strict=True)]
    bins = standings[best].bins
    text = f"{columns(rows)}\n{bins} bins; gaps in points to {best}, paired bootstrap over bins, 95 %; n attempts"
    if bound is None:
        return text
    return f"{text}\nof the bound: share of the DR that hindsight gains over {best}\n{bound.tally}"


def save_standings(
    path: Path, config: EvaluationConfig, best: str, standings: dict[str, Standing], records: Records
) -> None:
    """Write the numbers with their configuration and where they come from."""
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
        for name, own in standings.items()
    }
    bound = standings.get(HINDSIGHT)
    facts["hindsight"] = None if bound is None or bound.tally is None else asdict(bound.tally)
    commits = sorted({record.git_commit for own in records.values() for record in own})
    facts |= {"command": command_line(), "git_commits": commits, "versions": versions()}
    write_atomically(path, json_text(facts))


def _standing(records: Sequence[BinRecord]) -> Standing:
    delivered, parts = _deliveries(records).sum(axis=0).astype(int)
    successes, attempts = _successes(records).sum(axis=0).astype(int)
    return Standing(dr=rate(int(delivered), int(parts)), gsr=rate(int(successes), int(attempts)), bins=len(records))


def _against_the_bound(compared: dict[str, Standing], records: Records) -> dict[str, Standing]:
    """Note how much of the way from the best heuristic's DR to the bound's each has come, if the way is not chance."""
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
    won = [sum(pick.outcome is GraspOutcome.DELIVERED for pick in record.attempts) for record in records]
    return np.array([(n, len(record.attempts)) for n, record in zip(won, records, strict=True)], dtype=np.float64)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _span(low: float, high: float) -> str:
    return f"{100 * low:.1f} to {100 * high:.1f}"


def _gap(gap: Gap) -> str:
    value, low, high = (100 * each for each in gap)
    return f"{value:+.1f} ({low:+.1f} to {high:+.1f})"

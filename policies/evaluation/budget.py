"""The error budget: the same bins picked with true poses, with true segments, and from pixels alone."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from binpick_env.config import Perception
from perception.runtime.files import json_text, write_atomically
from policies.evaluation.config import EvaluationConfig
from policies.evaluation.jobs import Job
from policies.evaluation.records import BinRecord
from policies.evaluation.statistics import paired_ratio_difference
from policies.evaluation.summary import Summary
from policies.grasping.outcomes import GraspOutcome

MODES: tuple[Perception, ...] = ("oracle", "gt_masks", "learned")
COSTS: dict[str, tuple[Perception, Perception]] = {
    "pose": ("oracle", "gt_masks"),
    "segmentation": ("gt_masks", "learned"),
    "both": ("oracle", "learned"),
}
Runs = Mapping[Perception, tuple[EvaluationConfig, Job]]


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a stage costs: a number with the stage's ground truth given, minus the number without.

    Attributes:
        value: Difference of the two pooled numbers; None where one does not exist.
        low: Lower end of the 95 % interval, paired percentile bootstrap over the bins; None for a single bin.
        high: Upper end of the 95 % interval; None for a single bin.
    """

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Three evaluations of the same bins and their differences; the field names are the keys of budget.json.

    Attributes:
        part: Catalogue name or file of the part.
        sensor: Noise of the depth camera.
        bins: Number of bins.
        seed: Seed of the evaluations.
        costs: Costs by stage, "pose" (oracle - gt_masks), "segmentation" (gt_masks - learned) and "both", and then by
            number: gsr, dr and mpph.
        modes: Numbers of the evaluations, by perception.
    """

    part: str
    sensor: str
    bins: int
    seed: int
    costs: dict[str, dict[str, Cost]]
    modes: Mapping[Perception, Summary]

    def plain(self) -> dict[str, Any]:
        """Return every field by its name, as budget.json holds it."""
        costs = {stage: {name: asdict(cost) for name, cost in numbers.items()} for stage, numbers in self.costs.items()}
        modes = {mode: summary.plain() for mode, summary in self.modes.items()}
        return {**{field.name: getattr(self, field.name) for field in fields(self)}, "costs": costs, "modes": modes}


def budget_jobs(config: EvaluationConfig, job: Job) -> Runs:
    """Return the evaluations of a budget, each with its own folder below the job's."""
    return {mode: (replace(config, perception=mode), replace(job, out=job.out / mode)) for mode in MODES}


def make_budget(
    records: Mapping[Perception, Sequence[BinRecord]], modes: Mapping[Perception, Summary], rng: np.random.Generator
) -> Budget:
    """Compare three evaluations.

    Args:
        records: Records of the same bins in the same order, by perception.
        modes: Summaries of the records, by perception.
        rng: Random numbers for the bootstrap.

    Raises:
        ValueError: The bins are not the same.
    """
    seeds = {mode: [record.seed for record in kept] for mode, kept in records.items()}
    if any(seeds[mode] != seeds["oracle"] for mode in MODES):
        raise ValueError(f"the bins must be the same in {', '.join(MODES)}, but their seeds differ")
    any_mode = modes["learned"]
    costs = {}
    for stage, (given, without) in COSTS.items():
        pairs = zip(_counts(records[given]).items(), _counts(records[without]).values(), strict=True)
        costs[stage] = {name: _cost(*paired_ratio_difference(first, second, rng)) for (name, first), second in pairs}
    return Budget(
        part=any_mode.config["part"],
        sensor=any_mode.config["sensor"],
        bins=any_mode.bins,
        seed=any_mode.seed,
        costs=costs,
        modes=modes,
    )


def save_budget(path: Path, budget: Budget) -> None:
    """Write ``budget`` as JSON, in one piece."""
    write_atomically(path, json_text(budget.plain()))


def _counts(records: Sequence[BinRecord]) -> dict[str, list[tuple[float, float]]]:
    """Return numerator and denominator of gsr, dr and mpph in each bin."""
    counts: dict[str, list[tuple[float, float]]] = {"gsr": [], "dr": [], "mpph": []}
    for record in records:
        successes = sum(pick.outcome is GraspOutcome.DELIVERED for pick in record.attempts)
        seconds = sum(pick.seconds for pick in record.timed)
        counts["gsr"].append((successes, len(record.attempts)))
        counts["dr"].append((record.delivered, record.parts_total))
        counts["mpph"].append((3600.0 * successes, seconds))
    return counts


def _cost(*numbers: float) -> Cost:
    value, low, high = (None if np.isnan(number) else float(number) for number in numbers)
    return Cost(value=value, low=low, high=high)

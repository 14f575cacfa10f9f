"""Two evaluations of the same bins, compared bin by bin."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from perception.runtime.files import json_text, write_atomically
from policies.evaluation.conditions import flat_settings, given_numbers
from policies.evaluation.frame_summary import RATES, frame_counts, paired_ap
from policies.evaluation.jobs import CONFIG_FILE
from policies.evaluation.records import BinRecord, load_record
from policies.evaluation.statistics import paired_ratio_difference
from policies.grasping.outcomes import GraspOutcome

NUMBERS = ("gsr", "dr", "mpph", "ap", *RATES, "mpph_overlapped")  # keys of the numbers that are compared
# Settings that make the bins.
_SAME = ("part", "unit", "symmetry", "symmetry_tolerance", "density", "seed", "num_parts", "bin", "friction")
Pair = tuple[float, float]


class ComparisonError(ValueError):
    """A folder holds no evaluation, or two evaluations are not of the same bins."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """The evaluation in a folder of ``binpick pick``.

    Attributes:
        folder: Folder of the records.
        config: Every setting of the evaluation, by name.
        records: Records of all finished bins, by the number of the bin.
    """

    folder: Path
    config: Mapping[str, Any]
    records: Mapping[int, BinRecord]


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One number of two evaluations of the same bins, and its paired difference.

    Attributes:
        first: Number of the first evaluation, pooled over the bins; None if it does not exist or was not measured.
        second: Number of the second evaluation, likewise.
        difference: Second number minus first; None if either is missing.
        low: Lower end of the difference's 95 % interval, paired bootstrap over bins; None for a single bin.
        high: Upper end of the interval, likewise.
        given: Which of the two, "first" and "second", did not measure the number, because the ground truth was given.
    """

    first: float | None
    second: float | None
    difference: float | None = None
    low: float | None = None
    high: float | None = None
    given: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class BinComparison:
    """One bin in both evaluations.

    Attributes:
        index: Number of the bin.
        seed: Seed of the bin.
        parts_total: Number of parts after settling.
        delivered: Number of parts that each evaluation delivered.
        attempts: Number of attempts that each evaluation made.
        successes: Number of successful attempts of each evaluation.
        termination: Why the bin ended in each evaluation.
    """

    index: int
    seed: int
    parts_total: int
    delivered: tuple[int, int]
    attempts: tuple[int, int]
    successes: tuple[int, int]
    termination: tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two evaluations of the same bins; the field names are the keys of the JSON file.

    Attributes:
        first: Folder of the first evaluation.
        second: Folder of the second evaluation.
        part: Catalogue name or file of the part.
        seed: Seed of both evaluations.
        settings: Settings that differ, by name, with the value of each evaluation.
        commits: Commits of the code that made the records of each evaluation.
        left_out: Numbers of the bins that only one of the evaluations has.
        numbers: Numbers and their differences, by the keys of results.json.
        bins: The bins that both evaluations have.
    """

    first: str
    second: str
    part: str
    seed: int
    settings: dict[str, tuple[Any, Any]]
    commits: tuple[tuple[str, ...], tuple[str, ...]]
    left_out: tuple[int, ...]
    numbers: dict[str, Difference]
    bins: tuple[BinComparison, ...]


def load_run(folder: Path) -> Run:
    """Read the configuration and all finished bins of a folder of ``binpick pick``.

    Raises:
        ComparisonError: The folder holds no evaluation, or none of its bins is finished.
        RecordError: A record is damaged or of another version.
    """
    path = folder / CONFIG_FILE
    if not path.is_file():
        inside = sorted(each.parent.name for each in folder.glob(f"*/{CONFIG_FILE}"))
        hint = f"; did you mean one of the folders in it: {', '.join(inside)}?" if inside else ""
        raise ComparisonError(f"{folder} is no folder of `binpick pick`: it has no {CONFIG_FILE}{hint}")
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        digest, config = stored["hash"], stored["config"]
    except (ValueError, KeyError, TypeError) as error:
        raise ComparisonError(f"{path} is damaged") from error
    if not isinstance(digest, str) or not isinstance(config, dict):
        raise ComparisonError(f"{path} is damaged: its hash must be text, and its config an object")
    records = [load_record(each) for each in sorted(folder.glob("bin_*.json"))]
    own = {record.index: record for record in records if record.config_hash == digest}
    if not own:
        raise ComparisonError(f"{folder} has no finished bin")
    return Run(folder=folder, config=config, records=own)


def compare_runs(first: Run, second: Run) -> Comparison:
    """Compare two evaluations in the bins that both have; numbers are second minus first.

    Args:
        first: The evaluation that is compared with.
        second: The other evaluation.

    Raises:
        ComparisonError: The bins are not the same ones; the text names the differences.

    Note:
        Deterministic. The intervals of an AP take some seconds for 500 frames.
    """
    common = sorted(set(first.records) & set(second.records))
    _require_same_bins(first, second, common)
    pairs = [(first.records[index], second.records[index]) for index in common]
    rng = np.random.default_rng(int(first.config["seed"]))
    return Comparison(
        first=str(first.folder),
        second=str(second.folder),
        part=first.config["part"],
        seed=first.config["seed"],
        settings=_differing(flat_settings(first.config), flat_settings(second.config)),
        commits=(_commits(a for a, _ in pairs), _commits(b for _, b in pairs)),
        left_out=tuple(sorted(set(first.records) ^ set(second.records))),
        numbers={key: _difference(key, pairs, (first.config, second.config), rng) for key in NUMBERS},
        bins=tuple(_bin(*pair) for pair in pairs),
    )


def save_comparison(path: Path, comparison: Comparison) -> None:
    """Write ``comparison`` as JSON, in one piece."""
    write_atomically(path, json_text(asdict(comparison)))


def _require_same_bins(first: Run, second: Run, common: Sequence[int]) -> None:
    a, b = ({name: run.config.get(name) for name in _SAME} for run in (first, second))
    reasons = [f"{name} is {x} in the first and {y} in the second" for name, (x, y) in _differing(a, b).items()]
    if not reasons and not common:
        reasons = ["they have no bin in common"]
    if not reasons:
        for index in common:
            one, other = first.records[index], second.records[index]
            if (one.seed, one.parts_total) != (other.seed, other.parts_total):
                reasons.append(
                    f"bin {index} has {one.parts_total} parts from seed {one.seed} in the first, "
                    f"{other.parts_total} from seed {other.seed} in the second"
                )
    if reasons:
        raise ComparisonError(f"{first.folder} and {second.folder} are not comparable: {'; '.join(reasons)}")


def _differing(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    names = list(dict.fromkeys([*first, *second]))
    return {name: (first.get(name), second.get(name)) for name in names if first.get(name) != second.get(name)}


def _commits(records: Any) -> tuple[str, ...]:
    return tuple(sorted({record.git_commit for record in records}))


def _difference(
    key: str,
    pairs: Sequence[tuple[BinRecord, BinRecord]],
    configs: tuple[Mapping[str, Any], Mapping[str, Any]],
    rng: np.random.Generator,
) -> Difference:
    given = tuple(
        name
        for name, config in zip(("first", "second"), configs, strict=True)
        if key in given_numbers(config["perception"])
    )
    firsts, seconds = [a for a, _ in pairs], [b for _, b in pairs]
    if key == "ap":
        first, second, low, high = paired_ap(firsts, seconds, rng)
    else:
        a, b = ([_COUNTS[key](record) for record in records] for records in (firsts, seconds))
        first, second = _ratio(a), _ratio(b)
        _, low, high = paired_ratio_difference(b, a, rng)
    values = {"first": _number(first), "second": _number(second)} | dict.fromkeys(given)
    if values["first"] is None or values["second"] is None:
        return Difference(**values, given=given)
    return Difference(**values, difference=second - first, low=_number(low), high=_number(high))


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _ratio(counts: Sequence[Pair]) -> float:
    above, below = np.sum(counts, axis=0).tolist()
    return above / below if below > 0 else float("nan")


def _successes(record: BinRecord) -> int:
    return sum(pick.outcome is GraspOutcome.DELIVERED for pick in record.attempts)


def _seconds(record: BinRecord) -> float:
    return sum(pick.seconds for pick in record.timed)


def _seconds_on_one_clock(record: BinRecord) -> float:
    return sum(pick.seconds - pick.t_concurrent for pick in record.timed)


def _rate_counts(k: int) -> Callable[[BinRecord], Pair]:
    return lambda record: frame_counts(record.frames)[k]


_COUNTS: dict[str, Callable[[BinRecord], Pair]] = {  # numerator and denominator of each rate in a bin
    "gsr": lambda record: (_successes(record), len(record.attempts)),
    "dr": lambda record: (record.delivered, record.parts_total),
    "mpph": lambda record: (3600.0 * _successes(record), _seconds(record)),
    "mpph_overlapped": lambda record: (3600.0 * _successes(record), _seconds_on_one_clock(record)),
    **{name: _rate_counts(k) for k, name in enumerate(RATES)},
}


def _bin(first: BinRecord, second: BinRecord) -> BinComparison:
    return BinComparison(
        index=first.index,
        seed=first.seed,
        parts_total=first.parts_total,
        delivered=(first.delivered, second.delivered),
        attempts=(len(first.attempts), len(second.attempts)),
        successes=(_successes(first), _successes(second)),
        termination=(str(first.termination), str(second.termination)),
    )

"""``binpick s3dis-table``: the four rows of the paper's table 1, trained with several seeds and judged alike."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from perception.s3dis.choices import BudgetName
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from perception.s3dis.evaluation.table import TableConfig


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments):
    """Train the four rows of the paper's table 1 with several seeds and print both beside each other.

    The same command resumes where it was stopped; with more --seeds it adds trainings.
    """

    rooms: Path  # folder made by s3dis prepare: Area 5 is evaluated, the others are trained on
    steps: int  # number of steps of each training
    seeds: int = 3  # number of trainings of each row, with seeds 0, 1, ...
    budget: BudgetName = "small"  # paper: as it says; small: rows differ in trunk, colour and loss alone
    batch: int | None = None  # number of blocks per step; the budget's unless given
    points: int | None = None  # number of points sampled from a block; the budget's unless given
    held_out: int = 4  # number of training rooms kept to choose thresholds on
    out: Path = Path("runs/s3dis-table")  # folder of trainings and verdicts
    workers: int = 2  # number of processes, each on one core; each makes one training at a time
    json: Path | None = None  # JSON file for the rows

    def config(self) -> "TableConfig":
        """Return what the table depends on."""
        from perception.s3dis.evaluation.table import TableConfig

        return TableConfig(**{field.name: getattr(self, field.name) for field in fields(TableConfig)})


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and make the table; return the exit code."""
    return run(parse(Arguments, "s3dis-table", arguments))


def run(args: Arguments) -> int:
    """Make the table; return the exit code."""
    from binpick_env.jobs.process_map import WorkerError
    from perception.segmentation.training.errors import TrainingError

    stopped = f"stopped; the same command resumes from {args.out}"
    return exit_code(lambda: _table(args), (ValueError, OSError, WorkerError, TrainingError), stopped)


def _table(args: Arguments) -> str:
    import numpy as np

    from binpick_env.jobs.folder_config import ensure_same_config
    from binpick_env.jobs.process_map import map_indices
    from binpick_env.jobs.text_tables import columns
    from perception.runtime.files import write_atomically
    from perception.s3dis.data.record import recorded
    from perception.s3dis.evaluation.published import SOURCE, table_rows
    from perception.s3dis.evaluation.table import interval_lines, judge_rows, tabulate
    from policies.commands.progress import ProgressBar

    config = args.config()
    ensure_same_config(args.out / "table.json", config.note(), "trainings")
    judged = judge_rows(config, args.out, partial(map_indices, workers=args.places()))
    rows = tabulate(list(ProgressBar(judged, total=config.trainings, unit="training")), np.random.default_rng(0))
    if args.json is not None:
        write_atomically(args.json, recorded({**config.note(), "rows": [asdict(row) for row in rows]}))
    table = columns(table_rows([(row.row, row.scores) for row in rows]))
    return "\n".join([f"{SOURCE}; last four rows: {args.rooms}\n", table, "", columns(interval_lines(rows))])

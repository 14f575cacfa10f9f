"""The four rows of the paper's Table 1, trained with several seeds under one budget and judged on the same rooms."""

import logging
import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import WorkerError, map_indices
from binpick_env.jobs.text_tables import columns
from perception.runtime.files import write_atomically
from perception.s3dis.data.record import recorded
from perception.s3dis.evaluation.published import SOURCE, table_rows
from perception.s3dis.evaluation.table import TableConfig, interval_lines, judge_rows, tabulate
from perception.segmentation.training.loop import TrainingError


@dataclass(frozen=True, kw_only=True)
class Arguments(TableConfig):
    """Train the four rows of Table 1 with several seeds and print them beside the paper's.

    The same command again goes on where it was stopped; with more --seeds it adds trainings.
    """

    out: Path = Path("runs/s3dis-table")  # folder of trainings and verdicts
    workers: int = 2  # trainings at once; each computes on one core
    json: Path | None = None  # where to write the rows


def main(args: Arguments) -> int:
    """Make the table; return the exit code."""
    try:
        ensure_same_config(args.out / "table.json", args.note(), "trainings")
        judged = judge_rows(args, args.out, partial(map_indices, workers=args.workers))
        rows = tabulate(list(tqdm(judged, total=args.trainings, unit="training")), np.random.default_rng(0))
    except KeyboardInterrupt:
        print(f"\nstopped; the same command goes on from {args.out}", file=sys.stderr)
        return 130
    except (ValueError, OSError, WorkerError, TrainingError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{SOURCE}; last four rows: {args.rooms}\n")
    print(columns(table_rows([(row.row, row.scores) for row in rows])), "", columns(interval_lines(rows)), sep="\n")
    if args.json is not None:
        write_atomically(args.json, recorded({**args.note(), "rows": [asdict(row) for row in rows]}))
    return 0


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    sys.exit(main(tyro.cli(Arguments)))

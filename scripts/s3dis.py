"""The paper's Table 1: instance segmentation of the rooms of S3DIS."""

import logging
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
import tyro
from tqdm import tqdm

from binpick_env.jobs.folder_config import ensure_same_config
from binpick_env.jobs.process_map import WorkerError, map_indices
from binpick_env.jobs.text_tables import columns
from perception.runtime.files import write_atomically
from perception.runtime.threads import use_threads
from perception.s3dis.data.prepare import prepare_rooms, summary
from perception.s3dis.data.raw_tree import find_raw_rooms
from perception.s3dis.data.record import recorded
from perception.s3dis.evaluation.published import SOURCE, table_rows
from perception.s3dis.evaluation.subject import Subject
from perception.s3dis.scoring import S3disScores, match_rooms
from perception.s3dis.synthesis.building import SynthesisConfig, synthesize_rooms
from perception.s3dis.training import RowTraining, train_row
from perception.segmentation.training.distributed import processes
from perception.segmentation.training.loop import TrainingError
from perception.segmentation.training.progress import TrainingDisplay
from perception.segmentation.training.run import WEIGHTS

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


@dataclass(frozen=True, kw_only=True)
class Synthesize:
    """Write furnished rooms in the on-disk format of S3DIS, Area_1 to Area_6 in turn; goes on where it was stopped."""

    out: Path  # root of the tree
    rooms: int = 12
    seed: int = 0  # room i follows from this and i alone
    density: float = SynthesisConfig().density  # points on a square metre of surface; S3DIS is as dense as some 9000
    workers: int = 2  # processes; each computes on one core

    def run(self) -> None:
        """Write the rooms."""
        config = SynthesisConfig(seed=self.seed, density=self.density)
        ensure_same_config(self.out / "synthetic.json", asdict(config), "rooms")
        list(_bar(synthesize_rooms(config, self.rooms, self.out, _processes(self.workers)), self.rooms))
        print(f"{self.rooms} rooms in {self.out}")


@dataclass(frozen=True, kw_only=True)
class Prepare:
    """Read the raw tree of S3DIS (Area_*/ROOM/Annotations/*.txt) into one compact file a room.

    The same command again keeps the rooms that are whole and makes the others.
    """

    raw: Path  # the folder that Area_1 is in, of the aligned version 1.2
    out: Path  # folder of the rooms
    workers: int = 2  # processes; each computes on one core
    json: Path | None = None  # where to write what was made: rooms, points, remarks, seconds

    def run(self) -> None:
        """Prepare the rooms."""
        rooms = find_raw_rooms(self.raw)
        bar = _bar(prepare_rooms(rooms, self.out, _processes(self.workers)), len(rooms))
        made = summary(list(bar))
        if self.json is not None:
            write_atomically(self.json, recorded({**made, "seconds": bar.format_dict["elapsed"]}))
        print(*made["remarks"], f"{made['rooms']} rooms of {made['points']} points in {self.out}", sep="\n")


@dataclass(frozen=True, kw_only=True)
class Train(RowTraining):
    """Train a row of Table 1; goes on where it was stopped. Under torchrun, several processes train together."""

    device: str | None = None  # a GPU if there is one unless given
    threads: int | None = None  # of the processor; torch's choice unless given

    def run(self) -> None:
        """Train."""
        out = self.folder()
        with processes() as place, use_threads(self.threads), TrainingDisplay(out, False, place.rank == 0) as shown:
            device = self.device or (f"cuda:{place.local_rank}" if DEVICE == "cuda" else DEVICE)
            train_row(self, place, device, shown.on_step, shown.on_line)
        print(f"weights   {out / WEIGHTS}")


@dataclass(frozen=True, kw_only=True)
class Evaluate(Subject):
    """Print AP50 of the twelve categories beside the paper's Table 1."""

    workers: int = 2  # processes; each computes on one core
    json: Path | None = None  # where to write ap50 by category, mean_ap50, ap25, ap

    def run(self) -> None:
        """Evaluate."""
        paths = self.paths()
        judged = match_rooms(self.predict(DEVICE), paths, _processes(self.workers), self.population, self.seed)
        scores = S3disScores.of(list(_bar(judged, len(paths))))
        print(f"{SOURCE}; last row: {len(paths)} rooms of {self.rooms}\n")
        print(columns(table_rows([(self.name, scores)])))
        print(f"\nmean AP25 {100 * scores.ap25:.1f}, mean AP {100 * scores.ap:.1f}")
        if self.json is not None:
            write_atomically(self.json, recorded({**asdict(scores), **self.note(), "rooms": len(paths)}))


Arguments = Synthesize | Prepare | Train | Evaluate


def _processes(workers: int) -> Callable[..., Any]:
    return partial(map_indices, workers=workers)


def _bar(made: Iterable[Any], total: int) -> Any:
    return tqdm(made, total=total, unit="room", smoothing=0.02)


def main(args: Arguments) -> int:
    """Run a subcommand; return the exit code."""
    try:
        args.run()
    except KeyboardInterrupt:
        print("\nstopped; finished rooms are kept: the same command goes on from there", file=sys.stderr)
        return 130
    except (ValueError, OSError, WorkerError, TrainingError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    sys.exit(main(tyro.cli(Arguments)))

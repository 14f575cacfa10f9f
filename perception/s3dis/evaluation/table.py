"""Reproduction of Table 1: four rows, several seeds, one budget, the same rooms."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from perception.metrics.average_precision import percentile_interval, weighted_ap
from perception.metrics.matching import SceneMatches
from perception.runtime.file_work import FolderWork, Run
from perception.runtime.records import RecordError
from perception.s3dis.choices import BudgetName, RowName
from perception.s3dis.data.categories import CLUTTER, SCORED, TEST_AREA
from perception.s3dis.data.room import find_rooms
from perception.s3dis.evaluation.judged import JudgedRow, load_judged, save_judged
from perception.s3dis.predictor import RoomPredictor
from perception.s3dis.presets import ROWS
from perception.s3dis.scoring import S3disScores, match_rooms
from perception.s3dis.training import RowTraining, train_row
from perception.segmentation.training.run import WEIGHTS

SCORES = "scores.json"
RESAMPLES = 1000


@dataclass(frozen=True, kw_only=True)
class TableConfig:
    """Settings of the table."""

    rooms: Path  # folder of rooms made by prepare; Area 5 is tested on, the others are trained on
    steps: int  # number of steps of each training
    seeds: int = 3  # number of trainings of each row, with seeds 0, 1, ...
    budget: BudgetName = "small"  # small: rows differ only in trunk, colour and loss
    batch: int | None = None  # number of blocks in a step; the budget's unless given
    points: int | None = None  # number of points in a sample of a block; the budget's unless given
    held_out: int = 4  # number of training rooms to choose thresholds on

    def __post_init__(self) -> None:
        for name in ("steps", "seeds"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")

    @property
    def trainings(self) -> int:
        """Number of trainings."""
        return len(ROWS) * self.seeds

    def training(self, row: RowName, seed: int, out: Path | None = None) -> RowTraining:
        """Return a training of the table, whose files are in the folder ``out``."""
        return RowTraining(
            rooms=self.rooms,
            row=row,
            budget=self.budget,
            steps=self.steps,
            seed=seed,
            batch=self.batch,
            points=self.points,
            out=out,
            held_out=self.held_out,
        )

    def note(self) -> dict[str, Any]:
        """Return the settings that must not change between runs into one folder; the number of seeds may."""
        names = ("steps", "budget", "batch", "points", "held_out")
        return {
            **{name: getattr(self, name) for name in names},
            "rooms": str(self.rooms.resolve()),
            "number_of_rooms": len(find_rooms(self.rooms)),
            "trainings": {row: asdict(self.training(row, 0).config()) for row in ROWS},
        }


@dataclass(frozen=True, kw_only=True)
class TableRow:
    """A row of the table.

    Attributes:
        row: Name of the row.
        scores: Scores as means over the trainings.
        interval: 95 % interval of the mean AP50 over a bootstrap of the rooms.
        seeds: Mean AP50 of each training.
        gain: Mean AP50 minus that of the first row.
        gain_interval: 95 % interval of the gain over a bootstrap of the rooms, which are the same for both rows.
    """

    row: RowName
    scores: S3disScores
    interval: tuple[float, float]
    seeds: tuple[float, ...]
    gain: float
    gain_interval: tuple[float, float]


def judge_rows(config: TableConfig, out: Path, run: Run[JudgedRow] = map) -> Iterator[JudgedRow]:
    """Train and judge every row with every seed, and yield each result; finished trainings in ``out`` are reused.

    Args:
        config: Settings of the table.
        out: Folder of the trainings: checkpoints, weights, verdicts.
        run: Maps work over the indices of the trainings to do, which are sorted by seed, then by row.

    Raises:
        FileNotFoundError: There are no rooms to train on, or none of Area 5.
        ValueError: A room is damaged.
        TrainingError: A training diverged.
    """
    find_rooms(config.rooms, (TEST_AREA,))
    config.training(ROWS[0], 0).files()
    config = TableConfig(
        **{each.name: getattr(config, each.name) for each in fields(TableConfig)}
    )  # the plain class, where a script passes a subclass
    config = replace(config, rooms=config.rooms.resolve())  # as records name it, wherever they are written
    judged = {index: _judged(config, out, index) for index in range(config.trainings)}
    missing = [index for index, row in judged.items() if row is None]
    # The files of the rooms are named, so that each node of a cluster gets them once: all trainings read them, and with
    # each index they would be sent, and wait, once for every training.
    work = FolderWork(partial(_train_and_judge, config, tuple(find_rooms(config.rooms))), out)
    return chain((row for row in judged.values() if row is not None), run(work, missing))


def tabulate(judged: Sequence[JudgedRow], rng: np.random.Generator, resamples: int = RESAMPLES) -> list[TableRow]:
    """Return the rows of the table in its order, with percentile intervals over a bootstrap of the rooms.

    Args:
        judged: Verdicts on every training.
        rng: Source of the bootstrap.
        resamples: Number of resamples.

    Raises:
        ValueError: A row has no training, or the trainings were not judged on the same rooms.
    """
    if len({one.names for one in judged}) != 1 or {one.row for one in judged} != set(ROWS):
        raise ValueError("every row must be judged, and on the same rooms as the others")
    count = len(judged[0].names)
    weights = np.vstack([np.ones(count), rng.multinomial(count, np.full(count, 1.0 / count), size=resamples)])
    rows: list[TableRow] = []
    first = np.zeros(0)
    for row in ROWS:
        mine = sorted((one for one in judged if one.row == row), key=lambda one: one.seed)
        each = [weighted_ap([_scored(m) for m in one.matches], weights)[:, 1] for one in mine]
        means = np.mean(each, axis=0)  # (1 + R,) over the seeds, the first of the rooms as they are
        first = first if len(first) else means
        rows.append(
            TableRow(
                row=row,
                scores=_mean_scores([S3disScores.of(one.matches) for one in mine]),
                interval=percentile_interval(means[1:]),
                seeds=tuple(float(values[0]) for values in each),
                gain=float(means[0] - first[0]),
                gain_interval=percentile_interval(means[1:] - first[1:]),
            )
        )
    return rows


def interval_lines(rows: Sequence[TableRow]) -> list[list[str]]:
    """Return the cells of the table of intervals [%]."""
    cells = [["mean AP50 [%]", "mean", "95 % over rooms", "by seed", f"gain on {rows[0].row}", "95 % over rooms"]]
    for r in rows:
        seeds = " ".join(f"{100 * value:.1f}" for value in r.seeds)
        gain = f"{100 * r.gain:+.1f}", _spread(r.gain_interval)
        cells.append([r.row, f"{100 * r.scores.mean_ap50:.1f}", _spread(r.interval), seeds, *gain])
    return cells


def _training(config: TableConfig, out: Path, index: int) -> RowTraining:
    row, seed = ROWS[index % len(ROWS)], index // len(ROWS)
    return config.training(row, seed, out / f"{row}-{seed}")


def _judged(config: TableConfig, out: Path, index: int) -> JudgedRow | None:
    """Return the verdicts on the row and seed of an index; None without a complete record."""
    try:
        return load_judged(_training(config, out, index).folder() / SCORES)
    except RecordError:
        return None


def _train_and_judge(config: TableConfig, rooms: Sequence[Path], out: Path, index: int) -> JudgedRow:
    """Train and judge the row and seed of an index; ``rooms`` are the files of all rooms."""
    training = _training(config, out, index)
    train_row(training)
    predict = RoomPredictor.from_file(training.folder() / WEIGHTS)
    paths = [path for path in rooms if path.parent.name == f"Area_{TEST_AREA}"]
    names = tuple(f"{path.parent.name}/{path.stem}" for path in paths)
    judged = JudgedRow(row=training.row, seed=training.seed, names=names, matches=tuple(match_rooms(predict, paths)))
    save_judged(training.folder() / SCORES, judged)
    return judged


def _scored(matches: SceneMatches) -> SceneMatches:
    """Return the verdicts on the twelve categories."""
    kept = matches.labels != CLUTTER
    return SceneMatches(
        overlaps=matches.overlaps,
        truth_counts={label: count for label, count in matches.truth_counts.items() if label != CLUTTER},
        labels=matches.labels[kept],
        overlap_idx=matches.overlap_idx[kept],
        scores=matches.scores[kept],
        correct=matches.correct[kept],
    )


def _mean_scores(scores: Sequence[S3disScores]) -> S3disScores:
    return S3disScores(
        ap50={name: float(np.mean([s.ap50[name] for s in scores])) for name in SCORED},
        mean_ap50=float(np.mean([s.mean_ap50 for s in scores])),
        ap25=float(np.mean([s.ap25 for s in scores])),
        ap=float(np.mean([s.ap for s in scores])),
    )


def _spread(interval: tuple[float, float]) -> str:
    return f"{100 * interval[0]:.1f} to {100 * interval[1]:.1f}"

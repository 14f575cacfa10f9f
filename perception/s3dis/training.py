"""Training of a row of Table 1, and the choice of the threshold of its grouping."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from perception.metrics.matching import match_scene
from perception.runtime.job_files import resolved_path
from perception.s3dis.choices import BudgetName, RowName
from perception.s3dis.data.blocks import BlockConfig
from perception.s3dis.data.categories import AREAS, CATEGORIES, TEST_AREA
from perception.s3dis.data.dataset import BlockBatches, PackedRoom, load_packed_rooms, sees_colour
from perception.s3dis.data.room import Room, find_rooms, mean_sizes
from perception.s3dis.merging import MIN_SIZE_SHARE
from perception.s3dis.predictor import RoomPredictorConfig, describe_room, merge_samples_at, sample_grouping
from perception.s3dis.presets import row_training
from perception.s3dis.scoring import S3disScores, room_rng, room_truth
from perception.segmentation.training.distributed import Place
from perception.segmentation.training.loop import Length, StepRecord, Trainer
from perception.segmentation.training.presets import EPOCHS, TrainingConfig
from perception.segmentation.training.run import Log, RunConfig, resume, train
from perception.segmentation.weights import Network

NAME = "s3dis"  # entry of the networks' records in place of the name of a part
TRAINED_AREAS = tuple(area for area in AREAS if area != TEST_AREA)
THRESHOLDS = (1.0, 2.0, 3.0, 5.0, 7.5, 10.0)  # embedding distances to choose from; the margins are 5 and 10


@dataclass(frozen=True, kw_only=True)
class RowTraining:
    """A training on rooms."""

    rooms: Path  # folder of rooms made by prepare; the rooms of Area 5 are not used
    row: RowName = "dgcnn-new-colour"  # row of Table 1
    budget: BudgetName = "paper"  # paper: its settings, for a GPU; small: rows differ only in trunk, colour and loss
    steps: int | None = None  # number of steps; the paper's 200 epochs unless given
    seed: int = 0  # seed of the initial weights and the samples
    batch: int | None = None  # number of blocks in a step; the budget's unless given
    points: int | None = None  # number of points in a sample of a block; the budget's unless given
    learning_rate: float | None = None  # largest learning rate; the budget's unless given
    out: Path | None = None  # folder of checkpoint, log and weights; runs/s3dis-ROW-BUDGET-SEED unless given
    held_out: int = 4  # number of training rooms to choose the threshold of the grouping on; 0 takes the loss's

    def __post_init__(self) -> None:
        if self.held_out < 0:
            raise ValueError(f"held_out must be 0 or more, got {self.held_out}")
        self.config()

    def config(self) -> TrainingConfig:
        """Return the settings of the training."""
        given = {name: getattr(self, name) for name in ("batch", "points", "learning_rate")}
        chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        return replace(row_training(self.row, self.budget), seed=self.seed, **chosen)

    def folder(self) -> Path:
        """Return the folder of the training."""
        return self.out or Path("runs") / f"s3dis-{self.row}-{self.budget}-{self.seed}"

    def length(self, blocks: int, world: int = 1) -> Length:
        """Return the length of the training.

        Args:
            blocks: Number of blocks of all rooms.
            world: Number of processes that train together.
        """
        config = self.config()
        return Length(steps=self.steps if self.steps is not None else EPOCHS * blocks // (config.batch * world))

    def files(self) -> tuple[list[Path], list[Path]]:
        """Return the files of the rooms to train on, and of those held out, which are spread evenly over the rooms.

        Raises:
            FileNotFoundError: There are no rooms of the areas to train on.
            ValueError: No room would be left to train on.
        """
        paths = find_rooms(self.rooms, TRAINED_AREAS)
        if self.held_out >= len(paths):
            raise ValueError(f"held_out must be less than the {len(paths)} rooms to train on, got {self.held_out}")
        kept = [paths[k * len(paths) // self.held_out] for k in range(self.held_out)]
        return [path for path in paths if path not in kept], kept


def train_row(
    training: RowTraining,
    place: Place | None = None,
    device: str = "cpu",
    on_step: Callable[[StepRecord], None] | None = None,
    on_evaluation: Callable[[Log], None] | None = None,
) -> Log:
    """Train a row or resume its training, choose the threshold and write the weights.

    Args:
        training: Row, rooms and settings.
        place: Place of this process among those that train together.
        device: Device of the computation.
        on_step: Called after each step with its record.
        on_evaluation: Called with the last line of the log.

    Returns:
        The last line of the log; its ``validation`` is the result of `judge_thresholds`.

    Raises:
        FileNotFoundError: There are no rooms.
        ValueError: A room is damaged, or the folder holds another training.
        TrainingError: The training diverged.
        KeyboardInterrupt: The state is saved first.
    """
    place, config = place or Place(), training.config()
    training_files, held_out = training.files()
    rooms = load_packed_rooms(training_files)
    batches = BlockBatches.of(config, rooms, place.rank)
    min_sizes = (MIN_SIZE_SHARE * mean_sizes(packed.room for packed in rooms)).tolist()
    trainer = Trainer(config, batches, training.length(len(batches.scenes), place.world), device)
    run = RunConfig(
        out=training.folder(),
        parts=(NAME,),
        evaluate_every=np.inf,
        leader=place.rank == 0,
        sources=_sources(training, rooms, held_out, min_sizes),
    )

    def judge(network: Network) -> dict[str, float]:
        return judge_thresholds(network, held_out, config, min_sizes, device)

    resume(trainer, run)
    return train(trainer, judge if held_out else [], run, on_step, on_evaluation)


def judge_thresholds(
    network: Network, paths: Sequence[Path], config: TrainingConfig, min_sizes: Sequence[float], device: str = "cpu"
) -> dict[str, float]:
    """Return the best threshold of the grouping on rooms, with its mean AP50, AP25 and AP.

    Thresholds are compared by AP50, then by AP25, then by their distance to the threshold of the loss. SGPN's code
    chooses a threshold for each category from a faulty histogram.

    Args:
        network: Trained network.
        paths: Files of the rooms.
        config: Settings of the training.
        min_sizes: (13,) smallest number of points of an object of each category.
        device: Device of the computation.
    """
    groupings = [sample_grouping(config.points, config.pairs, threshold) for threshold in THRESHOLDS]
    how = RoomPredictorConfig(
        blocks=BlockConfig(points=config.points), min_sizes=tuple(min_sizes), colour=sees_colour(config.network)
    )
    matches = []
    for path in paths:
        room = Room.load(path)
        outputs = describe_room(network, room, room_rng(room.name, config.seed), how, device)
        found = merge_samples_at(groupings, outputs, room, how)
        matches.append([match_scene(room_truth(room), instances) for instances in found])
    scores = [S3disScores.of([room[k] for room in matches]) for k in range(len(THRESHOLDS))]
    best = max(range(len(scores)), key=lambda k: _rank(scores[k], THRESHOLDS[k], config.pairs.threshold))
    return {
        "threshold": THRESHOLDS[best],
        "ap50": scores[best].mean_ap50,
        "ap25": scores[best].ap25,
        "ap": scores[best].ap,
    }


def _rank(scores: S3disScores, threshold: float, expected: float) -> tuple[float, float, float]:
    known = np.nan_to_num([scores.mean_ap50, scores.ap25])  # NaN if the rooms have nothing to find
    return float(known[0]), float(known[1]), -abs(threshold - expected)


def _sources(
    training: RowTraining, rooms: Sequence[PackedRoom], held_out: Sequence[Path], min_sizes: Sequence[float]
) -> dict[str, Any]:
    return {
        "row": training.row,
        "budget": training.budget,
        "rooms": resolved_path(training.rooms),
        "trained_on": [packed.room.name for packed in rooms],
        "held_out": [f"{path.parent.name}/{path.stem}" for path in held_out],
        "min_sizes": dict(zip(CATEGORIES, min_sizes, strict=True)),
    }

"""``binpick s3dis``: the paper's table 1, instance segmentation of the rooms of S3DIS."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from binpick_env.jobs.text_tables import counted
from perception.s3dis.choices import BudgetName, Identity, Population, RowName
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from perception.s3dis.evaluation.subject import Subject
    from perception.s3dis.training import RowTraining


@dataclass(frozen=True, kw_only=True)
class Synthesize(WorkerArguments):
    """Write furnished rooms in the on-disk format of S3DIS, Area_1 to Area_6 in turn; resumes where it was stopped."""

    out: Path  # root folder of the tree
    rooms: int = 12  # number of rooms
    seed: int = 0  # seed of all rooms; room i is drawn from (seed, i)
    density: float = 1000.0  # number of points on a square metre of surface; S3DIS has some 9000

    def work(self) -> str:
        """Write the rooms."""
        from binpick_env.jobs.folder_config import ensure_same_config
        from perception.s3dis.synthesis.building import SynthesisConfig, synthesize_rooms

        config = SynthesisConfig(seed=self.seed, density=self.density)
        ensure_same_config(self.out / "synthetic.json", asdict(config), "rooms")
        list(_bar(synthesize_rooms(config, self.rooms, self.out, _runner(self)), self.rooms))
        return f"{counted(self.rooms, 'room')} in {self.out}"


@dataclass(frozen=True, kw_only=True)
class Prepare(WorkerArguments):
    """Read the raw tree of S3DIS (Area_*/ROOM/Annotations/*.txt) into one compact file a room.

    The same command keeps the rooms that are whole and makes the others.
    """

    raw: Path  # folder that Area_1 is in, of the aligned version 1.2
    out: Path  # folder of the rooms
    json: Path | None = None  # JSON file for the number of rooms and points, remarks, seconds

    def work(self) -> str:
        """Prepare the rooms."""
        from perception.runtime.files import write_atomically
        from perception.s3dis.data.prepare import prepare_rooms, summary
        from perception.s3dis.data.raw_tree import find_raw_rooms
        from perception.s3dis.data.record import recorded

        rooms = find_raw_rooms(self.raw)
        bar = _bar(prepare_rooms(rooms, self.out, _runner(self)), len(rooms))
        made = summary(list(bar))
        if self.json is not None:
            write_atomically(self.json, recorded({**made, "seconds": bar.format_dict["elapsed"]}))
        return "\n".join(
            [*made["remarks"], f"{counted(made['rooms'], 'room')} of {made['points']} points in {self.out}"]
        )


@dataclass(frozen=True, kw_only=True)
class Train:
    """Train a row of the paper's table 1, or resume it. Under torchrun, several processes train together."""

    rooms: Path  # folder made by prepare; rooms of Area 5 are not used
    row: RowName = "dgcnn-new-colour"  # row of Table 1
    budget: BudgetName = "paper"  # paper: as it says, for a GPU; small: rows differ in trunk, colour and loss alone
    steps: int | None = None  # number of steps; the paper's 200 epochs unless given
    seed: int = 0  # seed of weights and samples
    batch: int | None = None  # number of blocks per step; the budget's unless given
    points: int | None = None  # number of points sampled from a block; the budget's unless given
    learning_rate: float | None = None  # largest learning rate; the budget's unless given
    out: Path | None = None  # folder of checkpoint, log and weights; runs/s3dis-ROW-BUDGET-SEED unless given
    held_out: int = 4  # number of training rooms kept to choose the grouping's threshold on; 0 takes the loss's margin
    device: str | None = None  # device of torch, such as cpu or cuda:0; a GPU if there is one unless given
    threads: int | None = None  # number of torch's threads; torch's choice unless given

    def config(self) -> "RowTraining":
        """Return what the training depends on."""
        from perception.s3dis.training import RowTraining

        return RowTraining(**{field.name: getattr(self, field.name) for field in fields(RowTraining)})

    def work(self) -> str:
        """Train."""
        from perception.runtime.threads import use_threads
        from perception.s3dis.training import train_row
        from perception.segmentation.training.distributed import processes
        from perception.segmentation.training.progress import TrainingDisplay
        from perception.segmentation.training.run import WEIGHTS

        training = self.config()
        out = training.folder()
        with processes() as place, use_threads(self.threads), TrainingDisplay(out, False, place.rank == 0) as shown:
            found = _device()
            device = self.device or (f"cuda:{place.local_rank}" if found == "cuda" else found)
            train_row(training, place, device, shown.on_step, shown.on_line)
        return f"weights   {out / WEIGHTS}"


@dataclass(frozen=True, kw_only=True)
class Evaluate(WorkerArguments):
    """Print AP50 of the twelve categories beside the paper's table 1."""

    rooms: Path  # folder made by prepare
    weights: Path | None = None  # network to evaluate, the weights.safetensors of train
    predictions: Identity | None = None  # evaluate these instead of a network: the best that any network can do
    areas: tuple[int, ...] | None = None  # areas to evaluate on; 5 for weights, all for the truth unless given
    threshold: float | None = None  # embedding distance of the network's grouping; that of its training unless given
    # points that count: the room's, each once, or those of all blocks, as in SGPN's code
    population: Population = "room"
    seed: int = 0  # seed of the distribution of a block's points among samples
    json: Path | None = None  # JSON file for ap50 by category, mean_ap50, ap25 and ap

    def config(self) -> "Subject":
        """Return what is judged."""
        from perception.s3dis.evaluation.subject import Subject

        return Subject(**{field.name: getattr(self, field.name) for field in fields(Subject)})

    def work(self) -> str:
        """Evaluate."""
        from binpick_env.jobs.text_tables import columns
        from perception.runtime.files import write_atomically
        from perception.s3dis.data.record import recorded
        from perception.s3dis.evaluation.published import SOURCE, table_rows
        from perception.s3dis.scoring import S3disScores, match_rooms

        subject = self.config()
        paths = subject.paths()
        device = _device() if self.cluster is None else "cpu"  # a worker of a cluster computes on one core
        judged = match_rooms(subject.predict(device), paths, _runner(self), self.population, self.seed)
        scores = S3disScores.of(list(_bar(judged, len(paths))))
        if self.json is not None:
            write_atomically(self.json, recorded({**asdict(scores), **subject.note(), "rooms": len(paths)}))
        title = f"{SOURCE}; last row: {counted(len(paths), 'room')} of {self.rooms}\n"
        table = columns(table_rows([(subject.name, scores)]))
        return "\n".join([title, table, f"\nmean AP25 {100 * scores.ap25:.1f}, mean AP {100 * scores.ap:.1f}"])


Arguments = Synthesize | Prepare | Train | Evaluate


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and run a subcommand; return the exit code."""
    return run(parse(Arguments, "s3dis", arguments))


def run(args: Arguments) -> int:
    """Run a subcommand; return the exit code."""
    from binpick_env.jobs.process_map import WorkerError
    from perception.segmentation.training.errors import TrainingError

    stopped = "stopped; finished rooms are kept: the same command resumes there"
    return exit_code(args.work, (ValueError, OSError, WorkerError, TrainingError), stopped)


def _device() -> str:
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def _runner(places: WorkerArguments) -> Callable[..., Any]:
    from binpick_env.jobs.process_map import map_indices

    return partial(map_indices, workers=places.places())


def _bar(made: Iterable[Any], total: int) -> Any:
    from policies.commands.progress import ProgressBar

    return ProgressBar(made, total=total, unit="room", smoothing=0.02)

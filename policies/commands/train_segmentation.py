"""``binpick train-segmentation``: a network is trained on labelled scenes, evaluated meanwhile, and installed."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from binpick_env.options import CellOptions
from binpick_env.parts.label import part_label
from binpick_env.parts.unit import Unit
from perception.segmentation.training.choices import PresetName
from policies.commands.cell_arguments import CameraArguments, PileArguments
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from perception.segmentation.training.distributed import Place
    from perception.segmentation.training.loop import Length, Trainer
    from perception.segmentation.training.presets import TrainingConfig
    from perception.segmentation.training.progress import TrainingDisplay
    from perception.segmentation.training.run import Log, RunConfig

PLOT = "ap.svg"  # file beside the log: average precision against minutes


@dataclass(frozen=True, kw_only=True)
class _WhichParts:
    # parts that the network is for; generated: a network for every part, from scenes of generated parts
    part: tuple[str, ...] = ("tee",)
    unit: Unit | None = None  # length unit of part files' coordinates; guessed from the part's size unless given


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, CameraArguments, PileArguments, _WhichParts):
    """Train a segmentation network on the scenes of one part, one network for several, or one for every part.

    The training on one part makes the scenes itself where there are too few, and with preset ours it starts from the
    network for every part. The options of bin and camera are those of the scenes that it makes. The same command
    resumes where it was stopped. Under torchrun, several processes train together.
    """

    # folders of generate-scenes to train on; runs/scenes-PART-0 of each part unless given
    scenes: tuple[Path, ...] = ()
    # folders of generate-scenes to evaluate on; the first scenes of each folder unless given
    validation: tuple[Path, ...] = ()
    held_out: int = 8  # number of scenes of each folder that are kept for validation where no folder is given
    # network and settings of the training. ours: the image-plane network; the others are networks over points alone.
    # paper: DGCNN with SGPN's heads, trained as the paper's text says; released: PointNet with SGPN's heads, trained as
    # in SGPN's released code; dgcnn-context: EdgeConvs on three levels of the cloud, with the offsets of ours;
    # dgcnn-sgpn: the paper's network with the augmentation and the learning rate's schedule of ours
    preset: PresetName = "ours"
    # length of the training, with the making of scenes [min]; 200 epochs if neither minutes nor steps are given, except
    # with preset ours, which needs one of them
    minutes: float | None = None
    steps: int | None = None  # length of the training in steps; the same seed, steps and scenes give the same weights
    # number of scenes of one part to make, with those that are there; with --minutes as many as a third of them allows,
    # up to 1000, and with --steps 200 unless given. Scenes of other settings suffice if they are twice --held-out
    count: int | None = None
    workers: int = 2  # number of processes that make scenes, each on one core
    seed: int = 0  # seed of weights, samples and augmentation
    # weights to start from, a .safetensors file; none: random ones. For one part with preset ours those for every part
    # unless given, else random ones
    initial: Literal["none"] | Path | None = None
    batch: int | None = None  # number of scenes per step; the preset's unless given
    # largest learning rate of the schedule; the preset's unless given, or a lower one if one part with preset ours
    # starts from weights
    learning_rate: float | None = None
    threads: int | None = None  # number of torch's threads; torch's choice unless given
    device: str | None = None  # device of torch, such as cpu or cuda:0; a GPU if there is one unless given
    # training time between two evaluations [min]; a sixth of the training, from 1 to 10, unless given
    evaluate_every: float | None = None
    out: Path | None = None  # folder of checkpoint, log and weights; runs/segmentation-NAME-PRESET-SEED unless given
    # copy the weights to where every command looks first, which preset released refuses; unless given, with preset ours
    # if their AP50 is at least 0.5 and their AP not below that of the weights they started from
    install: bool | None = None
    tensorboard: bool = True  # write TensorBoard's events into the folder
    json: Path | None = None  # JSON file for the last evaluation

    @property
    def name(self) -> str:
        """Name that the weights are kept under."""
        from binpick_env.scenes.synthesis import MANY_PARTS
        from perception.segmentation.weights import GENERAL, SHARED

        if self.part == (MANY_PARTS,):
            return GENERAL
        return part_label(self.part[0]) if len(self.part) == 1 else SHARED

    @property
    def of_one_part(self) -> bool:
        """Whether the network is for one part."""
        from binpick_env.scenes.synthesis import MANY_PARTS

        return len(self.part) == 1 and self.part != (MANY_PARTS,)

    @property
    def fine_tunes(self) -> bool:
        """Whether the network for one part starts from trained weights."""
        return self.of_one_part and self.preset == "ours" and self.initial != "none"

    def options(self) -> CellOptions:
        """Return the cell in which scenes of the first part are made.

        Raises:
            ValueError: An option has no meaning.
        """
        names = {field.name for kind in (CameraArguments, PileArguments) for field in fields(kind)}
        given = {name: getattr(self, name) for name in names}
        return CellOptions(part=self.part[0], unit=self.unit, **given)

    def start(self) -> Path | None:
        """Return the weights that the training starts from, or None for random ones."""
        from perception.segmentation.weights import WeightsError, general_weights

        if self.initial is not None:
            return None if self.initial == "none" else self.initial
        if not self.fine_tunes:
            return None
        try:
            return general_weights()
        except WeightsError as error:
            raise WeightsError(f"{error}; --initial none starts from random weights") from error

    def config(self) -> "TrainingConfig":
        """Return how to train."""
        from perception.segmentation.training.presets import PRESETS, fine_tuning

        given = {"batch": self.batch, "learning_rate": self.learning_rate}
        chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        preset = PRESETS[self.preset]
        return replace(fine_tuning(preset) if self.fine_tunes else preset, seed=self.seed, **chosen)

    def folder(self) -> Path:
        """Return where the training is kept."""
        return self.out or Path("runs") / f"segmentation-{self.name}-{self.preset}-{self.seed}"

    def files(self) -> tuple[list[Path], list[Path]]:
        """Return the scene files to train and to validate on."""
        from perception.segmentation.training.dataset import split_scenes
        from policies.commands.training_scenes import scenes_made

        folders = self.scenes or tuple(self._scenes_of(part) for part in self.part)
        training, validation = split_scenes(folders, self.validation, self.held_out)
        made = scenes_made(self)
        return [path for path in training if not made or path.name in made], validation

    def _scenes_of(self, part: str) -> Path:
        """Return the folder of a part's scenes where none is given.

        Raises:
            FileNotFoundError: It holds none; the message is the command that makes them.
        """
        folder = default_scenes(part)
        if not any(folder.glob("scene_*.npz")):
            unit = ["--unit", self.unit] if self.unit is not None and Path(part).suffix else []
            command = shlex.join(["binpick", "generate-scenes", "--part", part, *unit, "--out", str(folder)])
            raise FileNotFoundError(f"{folder} holds no scene_*.npz; make them with: {command}")
        return folder

    def length(self, config: "TrainingConfig", scenes: int, world: int = 1, scene_minutes: float = 0.0) -> "Length":
        """Return how long to train: the paper's 200 epochs for every preset but ours where nothing is said.

        Args:
            config: Settings of the training.
            scenes: Number of scenes to train on.
            world: Number of processes that train together.
            scene_minutes: Time that the making of the scenes took [min]. At least half of the minutes remain.
        """
        from perception.segmentation.training.loop import Length
        from perception.segmentation.training.presets import EPOCHS

        if self.minutes is None and self.steps is None and self.preset != "ours":
            return Length(steps=EPOCHS * scenes // (config.batch * world))
        minutes = self.minutes
        if minutes is not None and scene_minutes > 0:
            minutes = max(minutes - scene_minutes, minutes / 2)
        return Length(steps=self.steps, minutes=minutes)

    def interval(self, length: "Length") -> float:
        """Return the time between two evaluations [min]."""
        if self.evaluate_every is not None:
            return self.evaluate_every
        minutes = (length.steps or 0) / 60 if length.minutes is None else length.minutes  # a step takes about 1 s
        return min(max(minutes / 6, 1.0), 10.0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and train; return the exit code."""
    return run(parse(Arguments, "train-segmentation", arguments))


def default_scenes(part: str) -> Path:
    """Return the folder of the scenes of a part where none is given."""
    return Path("runs") / f"scenes-{part_label(part)}-0"


def run(args: Arguments) -> int:
    """Train; return the exit code."""
    from binpick_env.cell.settle import SettleError
    from binpick_env.jobs.process_map import WorkerError
    from perception.segmentation.training.errors import TrainingError

    stopped = f"stopped; the same command resumes from {args.folder()}"
    return exit_code(lambda: _train(args), (ValueError, OSError, TrainingError, SettleError, WorkerError), stopped)


def _train(args: Arguments) -> str | None:
    import torch

    from perception.segmentation.training.distributed import processes
    from perception.segmentation.weights import load_record
    from policies.commands.training_scenes import scenes_of_training

    if args.install and args.preset == "released":
        raise ValueError(
            "--preset released cannot be installed, since no command looks for its network: leave --install out and "
            "give the file by --weights"
        )
    if args.threads is not None:
        torch.set_num_threads(args.threads)
    with processes() as place:
        args.length(args.config(), 1)  # nonsense is refused before scenes are made, and so are missing weights
        start = args.start()
        if start is not None:
            load_record(start)
        making = scenes_of_training(args, place)
        return _train_at(args, place, making.seconds / 60)


def _train_at(args: Arguments, place: "Place", scene_minutes: float) -> str | None:
    import torch
    from tqdm import tqdm

    from perception.segmentation.training.dataset import BatchMaker, load_packed, scene_sources
    from perception.segmentation.training.loop import Trainer
    from perception.segmentation.training.progress import TrainingDisplay
    from perception.segmentation.training.run import RunConfig, resume, train

    config, out, leader = args.config(), args.folder(), place.rank == 0
    training, validation = args.files()
    with tqdm(total=len(training), desc="reading", unit="scene", disable=not leader) as bar:
        scenes = load_packed(training, bar.update)
    length = args.length(config, len(scenes), place.world, scene_minutes)
    device = args.device or (f"cuda:{place.local_rank}" if torch.cuda.is_available() else "cpu")
    trainer = Trainer(config, BatchMaker.of(config, scenes, place.rank), length, device)
    uses = {"trained_on": scene_sources(training), "validated_on": scene_sources(validation)}
    run = RunConfig(
        sources={**_known_shapes(args.part, args.unit), **uses},
        out=out,
        parts=tuple(part_label(part) for part in args.part),
        initial=args.start(),
        evaluate_every=args.interval(length),
        scene_minutes=scene_minutes,
        leader=leader,
    )
    resumed = resume(trainer, run)
    if leader:
        print(_beginning(trainer, run, resumed))
    with TrainingDisplay(out, args.tensorboard, leader) as display:
        last = train(trainer, validation, run, display.on_step, lambda line: _show(line, out, display))
    return _deliver(args, out, last) if leader else None


def _beginning(trainer: "Trainer", run: "RunConfig", resumed: bool) -> str:
    """Return what the training starts from."""
    if resumed:
        return f"resuming at step {trainer.step}, {trainer.elapsed / 60:.1f} minutes"
    return f"starting from {'random weights' if run.initial is None else run.initial}"


def _show(line: "Log", out: Path, display: "TrainingDisplay") -> None:
    """Show an evaluation, and plot it with the previous ones."""
    from binpick_env.evaluation.segmentation.training_plot import ap_plot
    from perception.runtime.files import write_atomically
    from perception.segmentation.training.run import LOG, read_log

    display.on_line(line)
    plot = ap_plot(read_log(out / LOG))
    if plot is not None:
        write_atomically(out / PLOT, plot)


def _known_shapes(parts: tuple[str, ...], unit: Unit | None) -> dict[str, Any]:
    """Return what the record of the weights says of the shapes that were trained on."""
    from binpick_env.parts.families import HELD_OUT_FAMILIES, TRAINING_FAMILIES
    from binpick_env.parts.label import GENERATED
    from binpick_env.parts.part import load_part
    from binpick_env.scenes.synthesis import MANY_PARTS
    from perception.shape import shape_signature

    if parts != (MANY_PARTS,):
        units = {part: unit if Path(part).suffix else None for part in parts}  # a catalogue part has none
        return {"shapes": {part_label(p): shape_signature(load_part(p, unit=units[p]).model) for p in parts}}
    families = {"families": TRAINING_FAMILIES, "held_out_families": HELD_OUT_FAMILIES}
    return {
        "general": True,
        "shapes": {},
        **{name: [GENERATED + family for family in names] for name, names in families.items()},
    }


def _deliver(args: Arguments, out: Path, last: "Log") -> str:
    """Install the weights unless there is an objection; return the lines to print at the end."""
    from perception.runtime.files import json_text, write_atomically
    from perception.segmentation.training.acceptance import objection, scores
    from perception.segmentation.training.run import LOG, WEIGHTS, read_log
    from perception.segmentation.weights import install_weights

    first = next((line for line in read_log(out / LOG) if line["step"] == 0), {})
    lines = [f"weights   {out / WEIGHTS}", f"log       {out / LOG}"]
    if scores(last):
        lines += [f"plot      {out / PLOT}", f"validated {scores(last)}"]
    if scores(first):
        lines.append(f"at first  {scores(first)}")
    against = objection(last, first)
    if args.install or (args.install is None and args.preset == "ours" and against is None):
        try:
            path = install_weights(out / WEIGHTS, args.name)
        except OSError as error:
            raise OSError(
                f"the weights cannot be installed ({error}); they are kept in {out / WEIGHTS}. With another folder in "
                "BINPICK_CACHE, the same command installs them there"
            ) from error
        lines.append(f"installed {path} (delete it to return to the shipped weights)")
    elif args.install is None and args.preset == "ours":
        lines.append(f"not installed: {against}; the same command with --install True installs it all the same")
    if args.json is not None:
        write_atomically(args.json, json_text(last))
    return "\n".join(lines)

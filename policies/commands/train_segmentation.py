"""``binpick train-segmentation``: a network is trained on labelled scenes, evaluated meanwhile, and installed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from binpick_env.parts.label import part_label
from binpick_env.parts.unit import Unit
from perception.segmentation.training.choices import PresetName
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    from perception.segmentation.training.distributed import Place
    from perception.segmentation.training.loop import Length
    from perception.segmentation.training.presets import TrainingConfig
    from perception.segmentation.training.run import Log


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Train a segmentation network on the scenes of one part, one network for several, or one for every part.

    The same command resumes where it was stopped. Under torchrun, several processes train together.
    """

    # parts that the network is for; generated: a network for every part, from scenes of generated parts
    part: tuple[str, ...] = ("tee",)
    unit: Unit | None = None  # length unit of part files' coordinates; guessed from the part's size unless given
    # folders of generate-scenes to train on; runs/scenes-PART-0 of each part unless given
    scenes: tuple[Path, ...] = ()
    # folders of generate-scenes to evaluate on; the first scenes of each folder unless given
    validation: tuple[Path, ...] = ()
    held_out: int = 8  # number of scenes of each folder that are kept for validation where no folder is given
    # ours; paper: its text to the letter; released: as the code that the paper builds on
    preset: PresetName = "ours"
    minutes: float | None = None  # length of the training [min]
    steps: int | None = None  # length of the training in steps; the same seed and steps give the same weights
    seed: int = 0  # seed of weights, samples and augmentation
    initial: Path | None = None  # weights to start from, a .safetensors file; random ones unless given
    batch: int | None = None  # number of scenes per step; the preset's unless given
    learning_rate: float | None = None  # largest learning rate of the schedule; the preset's unless given
    threads: int | None = None  # number of torch's threads; torch's choice unless given
    device: str | None = None  # device of torch, such as cpu or cuda:0; a GPU if there is one unless given
    evaluate_every: float = 10.0  # training time between two evaluations [min]
    out: Path | None = None  # folder of checkpoint, log and weights; runs/segmentation-NAME-PRESET-SEED unless given
    # copy the weights to where every command looks first; with preset ours unless said otherwise
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

    def config(self) -> "TrainingConfig":
        """Return how to train."""
        from perception.segmentation.training.presets import PRESETS

        given = {"batch": self.batch, "learning_rate": self.learning_rate}
        chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        return replace(PRESETS[self.preset], seed=self.seed, **chosen)

    def folder(self) -> Path:
        """Return where the training is kept."""
        return self.out or Path("runs") / f"segmentation-{self.name}-{self.preset}-{self.seed}"

    def files(self) -> tuple[list[Path], list[Path]]:
        """Return the scene files to train and to validate on."""
        from perception.segmentation.training.dataset import split_scenes

        folders = self.scenes or tuple(Path("runs") / f"scenes-{part_label(part)}-0" for part in self.part)
        return split_scenes(folders, self.validation, self.held_out)

    def length(self, config: "TrainingConfig", scenes: int, world: int = 1) -> "Length":
        """Return how long to train: the paper's 200 epochs for its presets where nothing is said."""
        from perception.segmentation.training.loop import Length
        from perception.segmentation.training.presets import EPOCHS

        if self.minutes is None and self.steps is None and self.preset != "ours":
            return Length(steps=EPOCHS * scenes // (config.batch * world))
        return Length(steps=self.steps, minutes=self.minutes)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and train; return the exit code."""
    return run(parse(Arguments, "train-segmentation", arguments))


def run(args: Arguments) -> int:
    """Train; return the exit code."""
    from perception.segmentation.training.loop import TrainingError

    stopped = f"stopped; the same command resumes from {args.folder()}"
    return exit_code(lambda: _train(args), (ValueError, OSError, TrainingError), stopped)


def _train(args: Arguments) -> str | None:
    import torch

    from perception.segmentation.training.distributed import processes

    if args.threads is not None:
        torch.set_num_threads(args.threads)
    with processes() as place:
        return _train_at(args, place)


def _train_at(args: Arguments, place: "Place") -> str | None:
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
    batches = BatchMaker.of(config, scenes, place.rank)
    device = args.device or (f"cuda:{place.local_rank}" if torch.cuda.is_available() else "cpu")
    trainer = Trainer(config, batches, args.length(config, len(scenes), place.world), device)
    names = tuple(part_label(part) for part in args.part)
    uses = {"trained_on": scene_sources(training), "validated_on": scene_sources(validation)}
    sources = {**_known_shapes(args.part, args.unit), **uses}
    run = RunConfig(
        sources=sources, out=out, parts=names, initial=args.initial, evaluate_every=args.evaluate_every, leader=leader
    )
    if resume(trainer, run) and leader:
        print(f"resuming at step {trainer.step}, {trainer.elapsed / 60:.1f} minutes")
    with TrainingDisplay(out, args.tensorboard, leader) as display:
        last = train(trainer, validation, run, display.on_step, display.on_line)
    return _deliver(args, out, last) if leader else None


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
    from perception.runtime.files import json_text, write_atomically
    from perception.segmentation.training.run import LOG, WEIGHTS
    from perception.segmentation.weights import install_weights

    lines = [f"weights   {out / WEIGHTS}", f"log       {out / LOG}"]
    if args.preset == "ours" if args.install is None else args.install:
        path = install_weights(out / WEIGHTS, args.name)
        lines.append(f"installed {path} (delete it to return to the shipped weights)")
    if args.json is not None:
        write_atomically(args.json, json_text(last))
    return "\n".join(lines)

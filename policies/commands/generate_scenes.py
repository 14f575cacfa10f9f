"""``binpick generate-scenes``: labelled boundary scenes to train the segmentation on."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from binpick_env.config import AppearanceChoice, SensorChoice
from binpick_env.jobs.text_tables import counted
from binpick_env.parts.label import part_label
from policies.commands.cell_arguments import SceneArguments, scenes_of
from policies.commands.command_line import exit_code, parse
from policies.commands.worker_arguments import WorkerArguments

if TYPE_CHECKING:
    from binpick_env.scenes.synthesis import SceneConfig


@dataclass(frozen=True, kw_only=True)
class Arguments(WorkerArguments, SceneArguments):
    """Drop piles of parts and write their labelled boundary points, one compressed file per scene.

    The same command resumes where it was stopped; a larger --count adds scenes to those that are there.
    """

    count: int = 1000  # number of scenes
    seed: int = 0  # seed of all scenes; scene i is drawn from (seed, i); evaluate with another one than you train with
    out: Path | None = None  # folder of the scenes; runs/scenes-PART-SEED unless given
    workers: int = 2  # number of processes, each on one core
    sensor: SensorChoice = "good"  # noise of the depth camera; mixed draws good, harsh or none for each scene, all any
    jitter: bool = True  # vary the camera's pose and the light from scene to scene
    # grey image and surfaces of the parts; varied draws light, blur, labels, wear and deviations for each scene
    appearance: AppearanceChoice = "clean"
    min_parts: int = 20  # smallest number of parts in a bin
    max_parts: int = 30  # largest number of parts in a bin
    json: Path | None = None  # JSON file for the folder, the number of scenes and the seconds it took

    def folder(self) -> Path:
        """Return where the scenes are kept."""
        return self.out or Path("runs") / f"scenes-{part_label(self.part)}-{self.seed}"

    def config(self) -> "SceneConfig":
        """Return what a scene depends on."""
        from binpick_env.scenes.synthesis import SceneConfig

        return SceneConfig(
            **scenes_of(self.options()),
            seed=self.seed,
            num_parts=(self.min_parts, self.max_parts),
            sensor=self.sensor,
            jitter=self.jitter,
            appearance=self.appearance,
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and write the scenes; return the exit code."""
    return run(parse(Arguments, "generate-scenes", arguments))


def run(args: Arguments) -> int:
    """Write the scenes; return the exit code."""
    from binpick_env.cell.settle import SettleError
    from binpick_env.jobs.process_map import WorkerError

    stopped = f"stopped; finished scenes are kept in {args.folder()}: the same command resumes there"
    return exit_code(lambda: _generate(args), (ValueError, OSError, SettleError, WorkerError), stopped)


def _generate(args: Arguments) -> str:
    from binpick_env.scenes.synthesis import generate_scenes
    from perception.runtime.files import json_text, write_atomically
    from perception.runtime.provenance import git_commit
    from policies.commands.progress import ProgressBar

    out = args.folder()
    made = generate_scenes(args.config(), args.count, out, args.places())
    with ProgressBar(made, total=args.count, desc=args.part, unit="scene", smoothing=0.02) as bar:
        count = sum(1 for _ in bar)
        took = float(bar.format_dict["elapsed"])
    if args.json is not None:
        facts = {"out": str(out), "count": count, "seconds": took, "git_commit": git_commit()}
        write_atomically(args.json, json_text(facts))
    return f"{counted(count, 'scene')} in {out}"

"""Scenes that ``binpick train-segmentation`` makes itself where one part has too few."""

from pathlib import Path
from typing import TYPE_CHECKING

from binpick_env.cell.settle import SettleError
from binpick_env.jobs.text_tables import counted
from binpick_env.options import CellOptions
from binpick_env.parts.part import load_part
from binpick_env.scenes.timed_synthesis import (
    Making,
    SceneBudget,
    fine_tuning_scenes,
    holds_scenes_of,
    load_making,
    make_scenes,
)
from perception.segmentation.scene import BoundaryScene, SceneError
from policies.commands.progress import ProgressBar

if TYPE_CHECKING:
    from perception.segmentation.training.distributed import Place
    from policies.commands.train_segmentation import Arguments

STATE = "scene_time.json"  # file in the folder of the training
SHARE = 1 / 3  # share of the minutes in which scenes are made
MOST = 1000  # number of scenes that are made at most; they are held in memory, at 0.9 MB each
COUNT = 200  # number of scenes that are made for a training of a number of steps


def scenes_of_training(args: "Arguments", place: "Place") -> Making:
    """Make the scenes of a training on one part where there are too few; return the time that they took.

    Of several processes that train together, the first one makes them, and the others wait.
    """
    import torch

    if place.rank == 0 and _needed(args):
        _make(args)
    if place.world > 1:
        torch.distributed.barrier()
    return load_making(args.folder() / STATE) or Making()


def scenes_made(args: "Arguments") -> frozenset[str]:
    """Return the names of the scenes that the training is on; empty for all, unless it made some itself.

    Scenes that another training added since are not among them, so that the training can be resumed.
    """
    if not args.of_one_part or args.scenes:
        return frozenset()
    making = load_making(args.folder() / STATE)
    return frozenset() if making is None else frozenset(making.scenes)


def scene_budget(args: "Arguments") -> SceneBudget:
    """Return how many scenes to make, and within which time."""
    if args.count is not None or args.minutes is None:
        count = COUNT if args.count is None else args.count
        return SceneBudget(least=count, most=count)
    least = _fewest(args)
    return SceneBudget(least=least, most=max(least, MOST), seconds=60 * SHARE * args.minutes)


def _needed(args: "Arguments") -> bool:
    if args.count is not None and args.count < 1:
        raise ValueError(f"count must be at least 1, got {args.count}")
    if args.held_out < 0:  # as `split_scenes` does, but before scenes are made
        raise ValueError(f"held_out must not be negative, got {args.held_out}")
    options = args.options()
    chosen = options != CellOptions(part=options.part, unit=options.unit)
    if not args.of_one_part or args.scenes:
        if chosen:
            raise ValueError(
                "options of pile and camera are for scenes that the training makes, of one part and without --scenes: "
                "leave them out here, and give them to binpick generate-scenes"
            )
        return False
    paths = _scenes(args)
    if paths:
        _require_unit(args, paths[0])
        if chosen and not holds_scenes_of(fine_tuning_scenes(options), _folder(args)):
            raise ValueError(
                f"{_folder(args)} holds scenes of another pile or camera than these options say: delete it, or give "
                "the options to binpick generate-scenes with another --out and name that folder with --scenes"
            )
    making = load_making(args.folder() / STATE)
    if making is not None and args.count is None:
        return not making.done or not paths  # scenes that were deleted are made again
    return len(paths) < _wanted(args)


def _wanted(args: "Arguments") -> int:
    """Return the number of scenes below which more are made: that of the budget if those that are there are alike."""
    if args.count is not None:
        return args.count
    alike = holds_scenes_of(fine_tuning_scenes(args.options()), _folder(args))
    return scene_budget(args).most if alike else _fewest(args)


def _require_unit(args: "Arguments", path: Path) -> None:
    """Refuse scenes of a part file that was read in another unit: their folder has the same name.

    Raises:
        ValueError: The largest diameters differ by a factor of 1.5 or more.
    """
    part = args.part[0]
    if not Path(part).suffix:
        return  # only files have a unit
    try:
        there = BoundaryScene.load(path).d_max
    except SceneError:
        return  # the training leaves it out
    here = load_part(part, unit=args.unit).model.d_max
    if not 1 / 1.5 < there / here < 1.5:
        raise ValueError(
            f"{path.parent} holds scenes of a part of {there:.3g} m, but the largest diameter of {part} is {here:.3g} "
            "m: give the --unit that they were made with, name other folders with --scenes, or delete this one"
        )


def _fewest(args: "Arguments") -> int:
    """Return the number of scenes below which a folder holds too few: half of them would be held out."""
    return max(2 * args.held_out, 2)


def _folder(args: "Arguments") -> Path:
    from policies.commands.train_segmentation import default_scenes

    return default_scenes(args.part[0])


def _scenes(args: "Arguments") -> list[Path]:
    return sorted(_folder(args).glob("scene_*.npz"))


def _make(args: "Arguments") -> None:
    """Make scenes and show how far that is."""
    budget, folder, before = scene_budget(args), _folder(args), len(_scenes(args))
    print(f"making scenes in {folder}, {_limit(budget, args.minutes)}")
    made = make_scenes(fine_tuning_scenes(args.options()), folder, budget, args.folder() / STATE, args.places())
    shape = "{l_bar}{bar}| {elapsed}<{remaining}{postfix}"
    try:
        with ProgressBar(total=100, desc="scenes", unit="%", bar_format=shape) as bar:
            for count, making in made:
                share = count / budget.most if budget.seconds is None else min(making.seconds / budget.seconds, 1.0)
                bar.n = 100 * share
                bar.set_postfix(scenes=count, refresh=False)
                bar.update(0)
    except SettleError as error:
        raise SettleError(
            f"{error}: make scenes with binpick generate-scenes, --max-parts or --bin, and name them with --scenes"
        ) from error
    besides = f" besides {before} that were there" if before else ""
    made_now = len(_scenes(args)) - before
    print(f"made {counted(made_now, 'scene')}{besides} in {making.seconds / 60:.1f} min{_rest(args, making)}")


def _limit(budget: SceneBudget, minutes: float | None) -> str:
    if budget.seconds is None:
        return f"{budget.most} of them"
    return f"for {budget.seconds / 60:.1f} of the {minutes:g} minutes, but {budget.least} to {budget.most} of them"


def _rest(args: "Arguments", making: Making) -> str:
    minutes = args.length(args.config(), 1, scene_minutes=making.seconds / 60).minutes
    return "" if minutes is None else f"; {minutes:.1f} min remain for the training"

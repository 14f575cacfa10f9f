"""Scenes for the training on a single part, made within a share of the training's time."""

import json
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path

from binpick_env.jobs.workers import Workers
from binpick_env.options import CellOptions, scenes_of
from binpick_env.scenes.synthesis import SceneConfig, ensure_folder_config, generate_scenes, with_room
from perception.runtime.files import json_text, write_atomically
from perception.segmentation.scene import SCENES_NOTE


@dataclass(frozen=True, kw_only=True)
class SceneBudget:
    """Number of scenes to make.

    Attributes:
        least: Number of scenes that are made whatever time they take.
        most: Number of scenes that are made if there is time.
        seconds: Time after which no more than ``least`` scenes are made [s]; None for no limit.
    """

    least: int
    most: int
    seconds: float | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.least <= self.most:
            raise ValueError(f"least and most must be 1 <= least <= most, got {self.least} and {self.most}")
        if self.seconds is not None and not self.seconds >= 0:
            raise ValueError(f"seconds must not be negative, got {self.seconds}")


@dataclass(frozen=True, kw_only=True)
class Making:
    """State of the making of scenes, which is kept in a file, so that it can be resumed.

    Attributes:
        seconds: Time spent, over all starts [s].
        done: Whether all scenes are made, or the time is over.
        scenes: Names of the scenes' files once it is done, since another training may add to the folder.
    """

    seconds: float = 0.0
    done: bool = False
    scenes: tuple[str, ...] = ()


def load_making(path: Path) -> Making | None:
    """Return the state in a file, or None if there is no file.

    Raises:
        ValueError: The file is damaged.
    """
    if not path.exists():
        return None
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        scenes = tuple(str(name) for name in values.get("scenes", ()))
        return Making(seconds=float(values["seconds"]), done=bool(values["done"]), scenes=scenes)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path} is damaged ({error!r}); delete it, or choose another folder") from error


def fine_tuning_scenes(options: CellOptions) -> SceneConfig:
    """Return the configuration of scenes for the training on a single part.

    Sensor presets and appearances are drawn for each scene, as for the network for every part.

    Args:
        options: Part, bin and camera.
    """
    return SceneConfig(**scenes_of(options), sensor="all", appearance="varied")


def make_scenes(
    config: SceneConfig, folder: Path, budget: SceneBudget, state: Path, workers: Workers = 1
) -> Iterator[tuple[int, Making]]:
    """Write scenes until the budget is used, and yield the number of scenes and the state after each.

    Scenes that are there count. The time of loading the part and of starting the workers counts, too. A bin gets at
    most as many parts as it has room for.

    Args:
        config: Configuration of the scenes.
        folder: Folder of the scenes' files.
        budget: Number of scenes, and time.
        state: File of the state. Time that it names has been spent already.
        workers: Number of worker processes, or a cluster.

    Raises:
        ValueError: The folder holds scenes of another configuration, or there is no such part.
        WorkerError: A process was killed; every finished scene is kept.
    """
    started, before = time.perf_counter(), (load_making(state) or Making()).seconds
    config = with_room(config)
    _require_same(config, folder)

    def so_far(done: bool) -> Making:
        names = tuple(sorted(path.name for path in folder.glob("scene_*.npz"))) if done else ()
        making = Making(seconds=before + time.perf_counter() - started, done=done, scenes=names)
        write_atomically(state, json_text(asdict(making)))
        return making

    so_far(done=False)
    with closing(generate_scenes(config, budget.most, folder, workers)) as scenes:  # type: ignore[type-var]
        for count, _ in enumerate(scenes, 1):
            making = so_far(done=False)
            over = budget.seconds is not None and making.seconds >= budget.seconds
            if count == budget.most or (over and count >= budget.least):
                break
            yield count, making
    yield count, so_far(done=True)


def holds_scenes_of(config: SceneConfig, folder: Path) -> bool:
    """Tell whether a folder holds scenes that :func:`make_scenes` made with a configuration, or would add to."""
    if not (folder / SCENES_NOTE).exists():
        return False
    try:
        ensure_folder_config(with_room(config), folder)
    except ValueError:
        return False
    return True


def _require_same(config: SceneConfig, folder: Path) -> None:
    try:
        ensure_folder_config(config, folder)
    except ValueError as error:
        raise ValueError(
            f"{folder} holds too few scenes, and of other settings than those that train-segmentation makes: "
            "add some with binpick generate-scenes and a larger --count, name other folders with --scenes, "
            "or delete this one"
        ) from error

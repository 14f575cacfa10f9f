"""The main job as a pure function: one configuration and one index give one bin's record."""

import hashlib
import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from binpick_env.config import BinConfig, CameraConfig, CellConfig, Perception, SensorPreset
from binpick_env.env import BinPickEnv
from binpick_env.observation.perceiver import PoseNoise, make_perceiver
from binpick_env.parts import Part, Unit, load_part
from perception.runtime.provenance import git_commit
from policies.evaluation.frame_record import FrameRecord, judge_frame
from policies.evaluation.records import BinRecord
from policies.grasping.outcomes import PickResult
from policies.picking.episode import Picker, run_bin
from policies.picking.scripted import ScriptedPicker
from policies.picking.settings import PickerSettings
from policies.report.pictures import Album
from policies.report.recording import Recording
from policies.report.video import Film, WatchedEnv


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """What a bin's record depends on, and nothing else: not how many bins there are, nor who computes them."""

    part: str = "tee"  # catalogue name, or path to an STL, OBJ or PLY file
    unit: Unit | None = None  # of a part file's coordinates; None guesses metres or millimetres
    symmetry: Literal["detect", "none"] = "detect"
    density: float | None = None  # [kg/m^3]; None takes the catalogue's, or aluminium's for a file
    seed: int = 0  # of the whole evaluation; see `bin_seed`
    perception: Perception = "learned"
    sensor: SensorPreset = "good"
    num_parts: tuple[int, int] = (20, 30)  # smallest and largest fill of a bin
    camera: CameraConfig = field(default_factory=CameraConfig)
    pose_noise: PoseNoise = field(default_factory=PoseNoise)  # added by the oracle
    picker: PickerSettings = field(default_factory=PickerSettings)
    bin: tuple[float, float, float] | None = None  # length, width, height inside [m]; None is the standard bin

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, got {self.seed}")
        self.cell()
        low, high = self.num_parts
        if not 1 <= low <= high:
            raise ValueError(f"num_parts must be a rising pair from 1, got {self.num_parts}")

    def digest(self) -> str:
        """Return a hash of every setting, and of the part file's contents where the part is a file."""
        values = asdict(self)
        path = Path(self.part)
        if path.suffix and path.is_file():
            values["part"] = hashlib.sha256(path.read_bytes()).hexdigest()
        return hashlib.sha256(json.dumps(values, sort_keys=True, default=repr).encode()).hexdigest()[:16]

    def cell(self) -> CellConfig:
        """Return the cell's settings, the camera's aside."""
        return CellConfig() if self.bin is None else CellConfig(bin=BinConfig(inner_size=self.bin))

    def load_part(self) -> Part:
        """Load the part with its unit, symmetry and density."""
        return load_part(self.part, unit=self.unit, symmetry=self.symmetry, density=self.density)

    def check(self) -> Part:
        """Load what the configuration names, before any worker starts, and return the part.

        Raises:
            ValueError: There is no such part or perception mode, the part's file is not usable, or there are no weights
                for it where perception is "learned".
            FileNotFoundError: The part's file does not exist.
        """
        part = self.load_part()
        make_perceiver(self.perception, part.model, self.cell().bin.workspace(), self.pose_noise)
        return part


class BinError(RuntimeError):
    """A bin could not be evaluated; the text names its index and seed."""


class Cell(NamedTuple):
    """An environment and the picker that acts on it."""

    env: BinPickEnv
    picker: Picker


CellMaker = Callable[[EvaluationConfig], Cell]


class CellShelf(AbstractContextManager["CellShelf"]):
    """Keeps the cell of the last configuration: to build one takes seconds, and a reset leaves no trace of a bin."""

    def __init__(self, make_cell: CellMaker) -> None:
        """Keep what ``make_cell`` builds; nothing is built yet."""
        self._make_cell = make_cell
        self._digest = ""
        self._cell: Cell | None = None

    def cell(self, config: EvaluationConfig) -> Cell:
        """Return the cell for ``config``, the one that stands here if it fits."""
        digest = config.digest()
        if self._cell is None or digest != self._digest:
            self.close()
            self._cell, self._digest = self._make_cell(config), digest
        return self._cell

    def close(self) -> None:
        """Close the cell; the next one is built anew."""
        if self._cell is not None:
            self._cell.env.close()
        self._cell = None

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True, kw_only=True)
class Extras:
    """What else is made of a bin; none of it changes the record's numbers."""

    pictures: Path | None = None  # folder for pictures of the bin and of every decision
    video: Path | None = None  # mp4 file to film the bin into
    video_limit: float = 60.0  # length of the film in simulated time [s]
    rerun: Path | None = None  # rrd file to record the bin into


def bin_seed(seed: int, index: int) -> int:
    """Return the seed of bin ``index``: numpy's SeedSequence over (seed, index), so that no two evaluations overlap.

    It depends on nothing else: not on the number of bins, of workers, or on their order.
    """
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def watched_env(config: EvaluationConfig) -> WatchedEnv:
    """Build the environment that films and recordings can watch; on one thread, see `perception.runtime.threads`."""
    return WatchedEnv(
        part=config.load_part(),
        num_parts=config.num_parts,
        perception=config.perception,
        sensor=config.sensor,
        camera=config.camera,
        pose_noise=config.pose_noise,
        config=config.cell(),
        render_mode="rgb_array",
        threads=1,
    )


def scripted_cell(config: EvaluationConfig) -> Cell:
    """Build the cell with the scripted picker."""
    env = watched_env(config)
    return Cell(env, ScriptedPicker(env, config.picker))


def evaluate_bin(
    config: EvaluationConfig,
    index: int,
    extras: Extras | None = None,
    on_pick: Callable[[PickResult], None] | None = None,
    shelf: CellShelf | None = None,
) -> BinRecord:
    """Pick one bin to its end.

    Args:
        config: All that the record's numbers depend on, wall clock aside.
        index: Of the bin.
        extras: Pictures, film and recording, if wanted.
        on_pick: Called after each decision, for progress.
        shelf: Holds environment and picker between bins; without one the scripted cell is built, used and closed.

    Raises:
        BinError: Anything went wrong; the text names index and seed, the cause is attached.
    """
    seed = bin_seed(config.seed, index)
    try:
        if shelf is not None:
            return _evaluate(config, index, seed, extras or Extras(), on_pick, shelf.cell(config))
        with CellShelf(scripted_cell) as own:
            return _evaluate(config, index, seed, extras or Extras(), on_pick, own.cell(config))
    except Exception as error:
        if shelf is not None:
            shelf.close()  # nobody knows what state it is in
        reason = " ".join(str(error).split())  # on one line
        raise BinError(f"bin {index} (seed {seed}) failed: {type(error).__name__}: {reason}") from error


def _evaluate(
    config: EvaluationConfig,
    index: int,
    seed: int,
    extras: Extras,
    on_pick: Callable[[PickResult], None] | None,
    cell: Cell,
) -> BinRecord:
    env, picker = cell
    album = Album(extras.pictures, f"bin_{index:04d}")
    with Film.into(extras.video, env, limit=extras.video_limit) as film, Recording(extras.rerun, env) as recording:
        watched = _WatchedPicker(env, picker, album)
        result = run_bin(env, recording.around(watched), seed, on_pick)
        wall = time.perf_counter() - watched.start - watched.judging
        wall -= album.seconds + film.seconds + recording.seconds
    return BinRecord.from_result(
        result,
        watched.pictures,
        watched.frames,
        config_hash=config.digest(),
        index=index,
        wall=wall,
        settle=watched.settled - watched.start,
        render=watched.render,
        git_commit=git_commit(),
        before=watched.before,
        after=album.overview(env, "after"),
    )


class _WatchedPicker:
    """Passes decisions on, judges the frames they are made on, and keeps pictures of the settled bin and of each."""

    def __init__(self, env: BinPickEnv, picker: Picker, album: Album) -> None:
        self._env, self._picker, self._album = env, picker, album
        self.pictures: list[str] = []
        self.frames: list[FrameRecord] = []
        self.before = ""
        self.render = 0.0  # wall clock that frames took to render [s]
        self.judging = 0.0  # wall clock spent on comparing with the truth [s]
        self._frame_id = -1
        self.start = self.settled = time.perf_counter()

    def reset(self) -> None:
        self.settled = time.perf_counter()
        self._count_frame()
        self._picker.reset()
        self.before = self._album.overview(self._env, "before")

    def pick(self) -> PickResult:
        self._count_frame()
        judged = self._judge()
        labelled_capture, observed = (
            self._env.labelled_capture,
            self._env.observed,
        )  # the next ones come when the arm is back home
        result = self._picker.pick()
        self._count_frame()
        self.pictures.append(self._album.decision(labelled_capture, observed, judged, result.grasp, len(self.pictures)))
        return result

    def _judge(self) -> FrameRecord:
        """Judge the frame that is to be decided on; each only once."""
        start, env = time.perf_counter(), self._env
        if not self.frames or self.frames[-1].frame_id != env.frame_id:
            self.frames.append(judge_frame(env.frame_id, env.labelled_capture, env.observed))
        self.judging += time.perf_counter() - start
        return self.frames[-1]

    def _count_frame(self) -> None:
        if self._env.frame_id != self._frame_id:
            self._frame_id = self._env.frame_id
            self.render += self._env.render_time

"""``binpick bench``: speeds are measured, kept and compared."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from binpick_env.config import SensorPreset
from binpick_env.parts.unit import Unit
from policies.commands.cell_arguments import CellArguments, SceneArguments, scenes_of
from policies.commands.command_line import exit_code, parse


@dataclass(frozen=True, kw_only=True)
class Files:
    """Where rows are kept, or read from."""

    save: Path | None = None  # JSON file to keep the rows in
    json: Path | None = None  # the same as --save
    compare: tuple[Path, Path] | None = None  # compare two kept files, the older one first, and measure nothing


@dataclass(frozen=True, kw_only=True)
class Cell(Files, CellArguments):
    """Settling, stepping, camera frames by backend, attempts; everything on one core."""

    count: int = 25  # number of parts in the bin
    seed: int = 0  # seed of the first pile
    repeats: int = 5  # number of samples in each row, except those of picking
    picks: int = 20  # number of attempts in the rows of picking

    def measure(self) -> Iterator[Any]:
        """Yield the rows as they are measured."""
        from policies.benchmarks.cell import bench_cell

        return bench_cell(self.options(), self.count, self.seed, self.repeats, self.picks)


@dataclass(frozen=True, kw_only=True)
class Segmentation(Files, SceneArguments):
    """Labelled scenes, a frame from pixels to labelled points, training with and without what makes it fast."""

    sensor: SensorPreset = "good"  # noise of the depth camera
    seed: int = 0  # seed of the scenes
    repeats: int = 5  # number of samples in each row
    threads: int = 2  # number of torch's threads

    def measure(self) -> Iterator[Any]:
        """Yield the rows as they are measured."""
        from binpick_env.scenes.synthesis import SceneConfig
        from policies.benchmarks.segmentation import bench_segmentation

        config = SceneConfig(**scenes_of(self.options()), seed=self.seed, sensor=self.sensor)
        return bench_segmentation(config, self.repeats, self.threads)


@dataclass(frozen=True, kw_only=True)
class Pose(Files, SceneArguments):
    """Pose estimation against OpenCV's and Open3D's on the same inputs, with one thread and two."""

    sensor: SensorPreset = "good"  # noise of the depth camera
    count: int = 20  # number of scenes, each of three segments
    whole_scenes: int = 2  # number of scenes that are also searched as a whole
    seed: int = 0  # seed of the scenes
    opencv_python: Path | None = None  # interpreter of an environment with opencv-contrib-python-headless
    open3d_python: Path | None = None  # interpreter of an environment with open3d-cpu

    def measure(self) -> Iterator[Any]:
        """Yield the rows as they are measured."""
        from binpick_env.scenes.synthesis import SceneConfig
        from policies.benchmarks.pose import bench_pose

        interpreters = {"opencv": self.opencv_python, "open3d": self.open3d_python}
        config = SceneConfig(**scenes_of(self.options()), seed=self.seed, sensor=self.sensor)
        return bench_pose(config, self.count, self.whole_scenes, interpreters)


@dataclass(frozen=True, kw_only=True)
class Selection(Files, CellArguments):
    """Attempts a second of BinPickSelect-v0, in full and fast, in as many processes as there are workers."""

    seed: int = 0  # seed of the first pile
    picks: int = 40  # number of attempts of each process
    workers: int = 2  # number of processes, each on one core

    def measure(self) -> Iterator[Any]:
        """Yield the rows as they are measured."""
        from policies.benchmarks.selection import bench_selection

        return bench_selection(self.options(), self.seed, self.picks, self.workers)


@dataclass(frozen=True, kw_only=True)
class Scaling(Files, CellArguments):
    """A frame to poses with more and more parts, and more and more pixels; everything on one core."""

    counts: tuple[int, ...] = (5, 10, 25, 50, 100)  # numbers of parts in the bin
    count: int = 25  # number of parts at every width
    widths: tuple[int, ...] = (640, 1280, 2560)  # widths of the image [px]; its height follows
    seed: int = 0  # seed of the first pile
    repeats: int = 3  # number of piles, and frames, of each row

    def measure(self) -> Iterator[Any]:
        """Yield the rows as they are measured."""
        from policies.benchmarks.scaling import Steps, bench_scaling

        steps = Steps(counts=self.counts, count=self.count, widths=self.widths)
        return bench_scaling(self.options(), steps, self.seed, self.repeats)


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """What results cost on a Ray cluster, measured, and how fast clusters of other sizes would be, simulated."""

    cluster: str = "local"  # cluster that is measured: local starts one on this machine; auto or HOST:PORT joins one
    seconds: float = 1.0  # mean time of an item on one core [s]
    spread: float = 0.3  # standard deviation of the time, as a share of its mean
    megabytes: float = 0.1  # size of an item's result with its files [MB]
    items: int = 100_000  # number of items
    cores: tuple[int, ...] = (1, 10, 100, 1000, 10_000)  # numbers of cores of the clusters
    node_cores: int = 16  # number of cores of a node
    start: float = 10.0  # time until a new worker begins its first item [s]
    compilation: float = 60.0  # time that the first item of a node takes longer [s]
    network: float = 100.0  # rate of the network [MB/s]
    job: float = 15.0  # size of the files that travel to each node [MB]
    tasks: int = 200  # number of items in each measurement
    repeats: int = 5  # number of measurements
    seed: int = 0  # seed of the times of the items
    json: Path | None = None  # JSON file to write the result to

    def report(self) -> str:
        """Measure, simulate, and return the table."""
        from tqdm import tqdm

        from binpick_env.jobs.workers import Cluster as Place
        from policies.benchmarks.clusters import Items, Machines, measure_transport, predict, save_prediction

        items = Items(count=self.items, seconds=self.seconds, spread=self.spread, megabytes=self.megabytes)
        facts = {name: getattr(self, name) for name in ("node_cores", "start", "compilation", "network", "job")}
        clusters = [Machines(cores=count, **facts) for count in self.cores]
        place = Place(address=self.cluster, workers=2)
        rows = list(tqdm(measure_transport(place, self.tasks, self.repeats), desc="cluster", unit="row", total=3))
        predicted = predict(rows, items, clusters, self.seed)
        if self.json is not None:
            save_prediction(self.json, predicted)
            return f"{predicted}\nkept in   {self.json}"
        return str(predicted)


@dataclass(frozen=True, kw_only=True)
class Build:
    """What works that two builds are compared by have in common."""

    against: Path  # checkout of the build that is compared with this one, such as a git worktree of an older commit
    json: Path | None = None  # JSON file to write the result to
    part: str = "tee"  # name of a part, or the path of a part file
    unit: Unit | None = None  # length unit of a part file's coordinates; metres or millimetres, guessed, unless given
    count: int = 25  # number of parts in the bin
    sensor: SensorPreset = "good"  # noise of the depth camera
    seed: int = 0  # seed of the first input; each input has the next one
    repeats: int = 12  # number of inputs; each build does the work once on each, in turn
    threads: int = 1  # number of threads of each build

    def report(self) -> str:
        """Do the work in both builds and return the table."""
        from tqdm import tqdm

        from policies.benchmarks.builds import BuildJob, compare_builds, save_comparison

        names = ("part", "unit", "count", "sensor", "seed", "repeats", "threads")
        given = {name: getattr(self, name) for name in names}
        job = BuildJob(work=type(self).__name__.lower(), **given)
        with tqdm(total=self.repeats, desc=job.work, unit="pair") as bar:

            def show(done: int) -> None:
                bar.update(done - bar.n)

            compared = compare_builds(self.against, job, progress=show)
        if self.json is not None:
            save_comparison(self.json, compared)
            return f"{compared}\nkept in   {self.json}"
        return str(compared)


@dataclass(frozen=True, kw_only=True)
class Frame(Build):
    """This build against another: a frame to poses, by the learned pipeline, in a bin whose pose is given."""


@dataclass(frozen=True, kw_only=True)
class Camera(Build):
    """This build against another: a frame of the simulated camera."""


@dataclass(frozen=True, kw_only=True)
class Attempt(Build):
    """This build against another: an attempt of the picker in the full simulation, with the true poses."""


@dataclass(frozen=True, kw_only=True)
class Select(Build):
    """This build against another: four attempts in the fast selection environment."""


@dataclass(frozen=True, kw_only=True)
class Scenes(Build):
    """This build against another: a labelled scene."""


@dataclass(frozen=True, kw_only=True)
class Training(Build):
    """This build against another: a training step of the shared network."""


Measured = Cell | Segmentation | Pose | Selection | Scaling
Arguments = Measured | Cluster | Frame | Camera | Attempt | Select | Scenes | Training


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and measure; return the exit code."""
    return run(parse(Arguments, "bench", arguments))


def run(args: Arguments) -> int:
    """Measure, or compare; return the exit code."""
    return exit_code(lambda: _bench(args), (ValueError, OSError, RuntimeError))


def _bench(args: Arguments) -> str:
    if isinstance(args, Build | Cluster):
        return args.report()
    from tqdm import tqdm

    from policies.benchmarks.measurement import comparison_table, load_benchmark, save_benchmark

    if args.compare is not None:
        return comparison_table(*(load_benchmark(path) for path in args.compare))
    name = type(args).__name__.lower()
    rows = list(tqdm(args.measure(), desc=name, unit="row"))
    lines = [_table(args)(rows)]
    for path in filter(None, (args.save, args.json)):
        save_benchmark(path, name, rows)
        lines.append(f"kept in   {path}")
    return "\n".join(lines)


def _table(args: Measured) -> Callable[[Sequence[Any]], str]:
    if isinstance(args, Pose):
        from policies.benchmarks.pose import pose_table

        return pose_table
    from policies.benchmarks.measurement import benchmark_table

    return benchmark_table

"""``binpick perceive``: the poses of a part in frames of a real camera, and why some are lost."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from binpick_env.parts.label import part_label
from binpick_env.parts.unit import Unit
from perception.bin import Trust
from perception.bin.unit import bin_words
from perception.segmentation.choices import NetworkName
from policies.commands.command_line import exit_code, parse

if TYPE_CHECKING:
    from perception.frame import Workspace
    from perception.geometry import Floats
    from perception.part import PartModel
    from policies.frames import BinSettings, FrameJob, FrameOutcome, FrameRecord, FrameSource, GraspFinder

SMALLEST, LARGEST = 0.01, 10.0  # sides of no bin are shorter or longer [m]
UNREAD = 1  # exit code where a frame could not be read


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Find the poses of a part in frames of your camera, and say why some are lost.

    Name files, or a folder by --frames. State the bin by --bin and --bin-pose, let it be found by --bin alone or by
    --find-bin, or search everything by --no-bin. A bin that is stated is measured in each frame all the same. Exit
    codes: 0 if every frame was read, also where no part was found; 1 if one could not be read; 2 for options that have
    no meaning.
    """

    # depth images (16-bit PNG or TIFF, EXR, NPY), clouds (PCD, PLY, NPZ), recordings (ROS bag, MCAP, RealSense) or
    # frames that write_frame wrote
    frames: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    # folder of frames, instead of their files; the results are kept and resumed in --out
    frames_in: Annotated[Path | None, tyro.conf.arg(name="frames")] = None
    # part_a, part_b, part_c, tee, bracket, generated:FAMILY:INDEX, or the path of an STL, OBJ, PLY, OFF, GLB, 3MF or
    # STEP file
    part: str
    unit: Unit | None = None  # length unit of a part file's coordinates; metres or millimetres, guessed, unless given
    symmetry: Literal["detect", "none"] = "detect"  # rotational symmetry of a part file; none: ignore it
    # largest deviation of a part file's surface from itself under a symmetry [m]; 0.5 % of its diameter unless given
    symmetry_tolerance: float | None = None
    # length, width, height inside the bin [m], or one word in mm such as 360x260x120
    bin: tuple[float, float, float] | None = None
    # pose of the bin in the world: 16 numbers row by row, or a JSON file of them; its origin is the centre of the inner
    # floor, z up, and the world is the camera's frame (z forward) where no camera pose is known
    bin_pose: tuple[str, ...] | None = None
    find_bin: tyro.conf.FlagCreatePairsOff[bool] = False  # look for the bin in each frame; its size is measured, too
    measure_bin: bool = True  # measure the bin in each frame, starting from --bin-pose
    # what is corrected where a frame shows the bin elsewhere than --bin-pose says: camera: the camera's pose is right,
    # and the bin may have moved; bin: the bin stands in a fixture, and the camera's pose is corrected
    trust: Trust = "camera"
    no_bin: tyro.conf.FlagCreatePairsOff[bool] = False  # search everything within the depths of the frame
    # pose of the camera in the world (x right, y down, z forward): 16 numbers row by row, or a JSON file of them; that
    # of the frame's file, or the identity, unless given
    camera_pose: tuple[str, ...] | None = None
    # file of the calibration (RealSense, Azure Kinect, Open3D, BOP, OpenCV, ROS); that of the frame's file unless given
    calibration: Path | None = None
    # grey or colour image, registered to the depth; {stem} stands for the name of the frame's file
    grey: str | None = None
    # length of one unit of depth [m]; as the calibration says, or mm in integer images and m elsewhere, unless given
    depth_scale: float | None = None
    # stored depths that mean "no measurement"; 0, and 65535 in integers, unless given
    missing: tuple[float, ...] | None = None
    # what a depth image measures: along the camera's axis, or the distance from its centre along the ray of each pixel
    depth_along: Literal["axis", "ray"] = "axis"
    index: int = 0  # number of the frame in a recording (ROS bag, MCAP, RealSense); negative: from the end
    topic: str | None = None  # topic of the depth images or clouds in a recording; the only one unless given
    # topic of the grey or colour images in a recording, registered to the depth
    grey_topic: str | None = None
    # how the image's size relates to the calibrated one: equal, or scaled as a whole
    fit: Literal["same", "scale"] = "same"
    axes: Literal["opencv", "opengl"] = "opencv"  # axes of a cloud: y down and z forward, or y up and z backward
    # columns and rows of an organised cloud whose file does not state them; also one word such as 640x480
    grid: tuple[int, int] | None = None
    project: bool = False  # project an organised cloud into the stated camera, as unorganised ones are
    crop: tuple[int, int, int, int] | None = None  # part of the image to keep: u0, v0, width, height [px]
    quarter_turns: int = 0  # anticlockwise quarter turns of the image, after the crop
    network: NetworkName = "grid"  # kind of the segmentation network, whose shipped or installed weights are used
    json: Path | None = None  # JSON file for all frames
    rerun: Path | None = None  # record all frames into this .rrd, for Rerun's viewer; nothing is resumed
    overlay: Path | None = None  # folder of a PNG file for each frame, with the outlines of the parts found
    grasps: bool = False  # search grasps of a 2F-85 that are clear of everything else measured
    jaw: float | None = None  # largest opening of the jaw [m]; the gripper's whole stroke of 0.085 m unless given
    # pose of a UR5e's base (base_link: x to the front, z up) in the world: 16 numbers row by row, or a JSON file of
    # them; says which grasps are within reach
    robot_base: tuple[str, ...] | None = None
    bop: Path | None = None  # CSV file of the verified poses in the results format of the BOP challenge
    bop_object: int = 1  # number of the part's model in the BOP data set
    bop_scene: int | None = None  # number of the scene in it; that of the folder SCENE/depth, or 1, unless given
    # folder of a JSON and a PNG file for each frame; frames whose results are there are skipped,
    # unless a file that they were read from changed;
    # runs/perceive-PART-FOLDER with --frames, otherwise none unless given
    out: Path | None = None

    def folder(self) -> Path | None:
        """Return where the results of each frame are kept; None if they are not."""
        if self.out is not None or self.frames_in is None:
            return self.out
        return Path("runs") / f"perceive-{part_label(self.part)}-{self.frames_in.resolve().name}"

    def paths(self) -> tuple[Path, ...]:
        """Return the files of the frames.

        Raises:
            FileNotFoundError: There is no folder of that name.
            ValueError: Files and a folder are both given, the folder holds no frame, or the results would go there.
        """
        from policies.frames import frames_in

        if self.frames_in is None:
            return self.frames
        if self.frames:
            raise ValueError(f"name files of frames or a folder by --frames, but not both, got {self.frames[0]}, too")
        for option, place in (("--out", self.folder()), ("--overlay", self.overlay)):
            if place is not None and place.resolve() == self.frames_in.resolve():
                raise ValueError(f"{option} must be another folder than that of the frames, got {place}")
        return frames_in(self.frames_in, grey=self.grey, calibration=self.calibration)

    def workspace(self) -> "Workspace | None":
        """Return the bin; None without one.

        Raises:
            FileNotFoundError: The file of its pose does not exist.
            ValueError: Options contradict each other, or a value has no meaning.
        """
        import numpy as np

        from perception.frame import Workspace
        from policies.frames import parse_pose

        _check_size(self.bin)
        stated = self.bin is not None or self.bin_pose is not None
        if self.no_bin and (stated or self.find_bin):
            raise ValueError("state the bin by --bin and --bin-pose, or none by --no-bin, but not both")
        if self.find_bin and stated:
            raise ValueError(
                "--find-bin measures place and size: leave out --bin and --bin-pose, or state the bin alone"
            )
        if self.trust == "bin" and (self.bin_pose is None or not self.measure_bin):
            raise ValueError("--trust bin needs the place of the bin, by --bin and --bin-pose, and measures it")
        if not self.measure_bin and self.bin_pose is None:
            raise ValueError(
                "--no-measure-bin takes the bin as it is stated: give --bin and --bin-pose, or leave it out"
            )
        if self.no_bin or self.find_bin:
            return None
        if self.bin is None:
            raise ValueError(
                "the bin must be known: give --bin LENGTHxWIDTHxHEIGHT [mm] and --bin-pose, --bin or --find-bin to "
                "look for it, or --no-bin to search all"
            )
        if self.bin_pose is None:
            return None
        return Workspace(T_world_bin=parse_pose(self.bin_pose, "T_world_bin"), inner_size=np.array(self.bin))

    def bin_settings(self) -> "BinSettings":
        """Return how the bin in the frames is known."""
        import numpy as np

        from policies.frames import BinSettings

        find = self.bin_pose is None and not self.no_bin
        size = np.array(self.bin) if find and self.bin is not None else None
        return BinSettings(measure=self.measure_bin, trust=self.trust, find=find, inner_size=size)

    def base_pose(self) -> "Floats | None":
        """Return the (4, 4) pose of the robot's base in the world; None without a robot.

        Raises:
            FileNotFoundError: The file of the base's pose does not exist.
            ValueError: An option of grasps has no meaning.
        """
        from policies.frames import parse_pose

        if not self.grasps and (self.jaw is not None or self.robot_base is not None):
            raise ValueError("--jaw and --robot-base are about grasps: give --grasps, too")
        if self.robot_base is None:
            return None
        if self.bin_pose is None:
            raise ValueError("the reach of a robot needs a bin: give --bin and --bin-pose, or leave out --robot-base")
        return parse_pose(self.robot_base, "T_world_base")

    def finder(
        self, part: "PartModel", workspace: "Workspace | None", T_world_base: "Floats | None"
    ) -> "GraspFinder | None":
        """Return the search for grasps; None without one.

        Args:
            part: Part to grip.
            workspace: The bin; None if it is not known beforehand.
            T_world_base: Pose of :meth:`base_pose`.

        Raises:
            ValueError: An option has no meaning, or there is no grasp on the part.
        """
        from policies.frames import GraspFinder, Reach

        if not self.grasps:
            return None
        if T_world_base is None or workspace is None:
            return GraspFinder(part, jaw=self.jaw)
        return GraspFinder(part, jaw=self.jaw, reach=Reach(T_world_base, workspace, self.jaw))

    def source(self) -> "FrameSource":
        """Return how the frames are read.

        Raises:
            FileNotFoundError: The file of the calibration or of the camera's pose does not exist.
            ValueError: A value has no meaning.
        """
        from perception.capture import ReadOptions
        from policies.frames import FrameSource, parse_pose

        if self.calibration is not None and not self.calibration.exists():
            raise FileNotFoundError(f"there is no calibration {self.calibration}")
        return FrameSource(
            grey=self.grey,
            calibration=self.calibration,
            T_world_cam=None if self.camera_pose is None else parse_pose(self.camera_pose, "T_world_cam"),
            options=ReadOptions(
                scale=self.depth_scale,
                missing=self.missing,
                depth_along=self.depth_along,
                index=self.index,
                topic=self.topic,
                grey_topic=self.grey_topic,
                fit=self.fit,
                axes=self.axes,
                grid=self.grid,
                project=self.project,
                crop=self.crop,
                quarter_turns=self.quarter_turns,
            ),
        )

    def job(self) -> "FrameJob":
        """Return which frames are perceived, and where the results are kept."""
        from policies.frames import FrameJob

        return FrameJob(
            paths=self.paths(),
            source=self.source(),
            folder=self.frames_in,
            out=self.folder(),
            overlay=self.overlay,
            fresh=self.rerun is not None,
        )


def _check_size(size: tuple[float, float, float] | None) -> None:
    """Raise ``ValueError`` if the sides of a bin [m] must be in another unit, or are no lengths."""
    if size is None or (min(size) >= SMALLEST and max(size) <= LARGEST):
        return
    got = " x ".join(f"{value:g}" for value in size)
    three = max(size) > LARGEST  # words, which were taken as metres; or one word, as millimetres
    advice = bin_words(size, without="metres") if three else bin_words([1e3 * v for v in size], without="millimetres")
    raise ValueError(
        f"--bin must have sides of {1000 * SMALLEST:g} mm to {LARGEST:g} m, got {got} m: three words are metres, one "
        f"word such as 360x260x120 is millimetres; type {advice or 'its inner sides'}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the options and perceive; return the exit code."""
    return run(parse(Arguments, "perceive", arguments))


def run(args: Arguments) -> int:
    """Perceive the frames; return the exit code."""
    from perception.segmentation.weights import WeightsError

    out = args.folder()
    stopped = "stopped" if out is None else f"stopped; the same command resumes in {out}"
    outcomes: list[FrameOutcome] = []
    errors = (ValueError, OSError, ModuleNotFoundError, WeightsError)
    code = exit_code(lambda: _perceive(args, outcomes), errors, stopped)
    unread = any(outcome.values is None for outcome in outcomes)
    return UNREAD if code == 0 and unread else code


def _perceive(args: Arguments, outcomes: list["FrameOutcome"]) -> str | None:
    """Perceive the frames, print what becomes of each, and append it to ``outcomes``."""
    import sys

    from tqdm import tqdm

    from binpick_env.parts import load_part
    from policies.frames import BopNames, FramePerceiver, perceive_frames, save_bop_results, save_records
    from policies.frames.bop import image_numbers
    from policies.report.recording import check_recording

    if args.rerun is not None:
        check_recording(args.rerun)
    job, workspace, T_world_base = args.job(), args.workspace(), args.base_pose()
    job.require_files()
    names = BopNames(obj_id=args.bop_object, scene_id=args.bop_scene)
    if args.bop is not None:
        image_numbers(job.paths, names.scene_id)  # now, rather than when all frames are done
    part = load_part(args.part, unit=args.unit, symmetry=args.symmetry, symmetry_tolerance=args.symmetry_tolerance)
    origin = part.file.origin if part.file else (0.0, 0.0, 0.0)
    perceiver = FramePerceiver(
        part.model, workspace, origin_in_file=origin, bin=args.bin_settings(), network=args.network
    )
    finder = args.finder(part.model, workspace, T_world_base)
    with (
        _recording(args.rerun) as record,
        _quiet_causes(),
        tqdm(total=len(job.paths), unit="frame", smoothing=0.02, disable=len(job.paths) < 2) as bar,
    ):
        for outcome in perceive_frames(job, perceiver, finder):
            if outcome.record is not None:
                record(outcome.record)
            outcomes.append(replace(outcome, record=None))  # which holds the frame
            if outcome.values is None:
                bar.write(f"error: {outcome.path}: {outcome.lines[0]}", file=sys.stderr)
            else:
                bar.write("\n".join(outcome.lines) + "\n", file=sys.stdout)
            bar.update()
    if args.json is not None:
        save_records(args.json, outcomes)
    if args.bop is not None:
        save_bop_results(args.bop, outcomes, names)
    places = {
        "numbers": args.json,
        "BOP": args.bop,
        "outlines": args.overlay,
        "recording": args.rerun,
        "results": job.out,
    }
    ends = [f"{label:<9} {place}" for label, place in places.items() if place is not None]
    if len(outcomes) > 1:
        ends.insert(0, f"frames    {_counts(outcomes)}")
    return "\n".join(ends) or None


@contextmanager
def _quiet_causes() -> Iterator[None]:
    """Keep likely causes out of the log: the report of each frame has them."""
    import logging

    log = logging.getLogger("perception.diagnosis.log")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


@contextmanager
def _recording(path: Path | None) -> Iterator[Callable[["FrameRecord"], None]]:
    """Open a recording and yield what adds a frame to it; nothing does if the path is None."""
    if path is None:
        yield lambda _: None
        return
    from policies.report.frame_recording import FrameRecording

    with FrameRecording(path) as recording:
        yield recording.add


def _counts(outcomes: Sequence["FrameOutcome"]) -> str:
    """Return how many frames show parts, how many show none, and how many could not be read."""
    read = [outcome.values["poses"] for outcome in outcomes if outcome.values is not None]
    full = sum(any(pose["verified"] for pose in poses) for poses in read)
    text = f"{len(outcomes)}: {full} with parts, {len(read) - full} without"
    return text if len(read) == len(outcomes) else f"{text}, {len(outcomes) - len(read)} could not be read"

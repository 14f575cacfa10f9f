"""Many frames, one after the other: bad files are reported, finished frames are kept and skipped."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2

from binpick_env.jobs.folder_config import ensure_same_config
from perception.capture import ReadOptions, ReadReport, read_frame_with_report
from perception.capture.damage import require_file
from perception.frame import Frame
from perception.geometry import Floats
from perception.pipeline import Perception
from perception.runtime.files import json_text, write_atomically
from perception.runtime.provenance import command_line, git_commit, versions
from perception.shape import shape_signature
from policies.frames.frame_digests import changes, digests
from policies.frames.frame_files import STEM
from policies.frames.frame_perceiver import FramePerceiver, workspace_of_depth
from policies.frames.frame_record import VERSION, FrameRecord, Values, frame_lines
from policies.frames.grasp_finder import FrameGrasp, GraspFinder
from policies.frames.overlay import draw_poses, save_picture

INPUTS = "inputs"  # key of the digests of the files that a frame was read from
OLDER = {"index": 0}  # options that configurations of older versions lack, as they were


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameSource:
    """How the frames of a camera are read."""

    grey: str | None = None  # path of the grey images, with {stem} for the name of the frame's file; None: none
    calibration: Path | None = None  # file of the calibration; None if the frames hold it
    T_world_cam: Floats | None = None  # (4, 4) camera pose; None for the one that the files state, or the identity
    options: ReadOptions = field(default_factory=ReadOptions)  # what the files do not say themselves

    def read(self, path: Path) -> tuple[Frame, ReadReport]:
        """Read a frame; see :func:`perception.capture.read_frame_with_report`."""
        return read_frame_with_report(
            path,
            grey=self.grey_of(path),
            calibration=self.calibration,
            T_world_cam=self.T_world_cam,
            options=self.options,
        )

    def grey_of(self, path: Path) -> str | None:
        """Return the path of the grey image of a frame; None without one."""
        return None if self.grey is None else self.grey.replace(STEM, path.stem)

    def digests(self, path: Path) -> dict[str, str | None]:
        """Return the digests of the files that a frame is read from, by what they are."""
        grey = self.grey_of(path)
        return digests(path, None if grey is None else Path(grey), self.calibration)

    def values(self) -> Values:
        """Return what the results depend on besides the contents of files, as JSON values."""
        return {
            "grey": self.grey,
            "calibration": None if self.calibration is None else str(self.calibration),
            "T_world_cam": None if self.T_world_cam is None else self.T_world_cam.tolist(),
            **asdict(self.options),
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameJob:
    """Which frames are perceived, and where the results are kept."""

    paths: tuple[Path, ...]  # files of the frames
    source: FrameSource  # how they are read
    folder: Path | None = None  # folder that holds them all, if they were named by it
    out: Path | None = None  # folder of a JSON and a PNG file for each frame; None keeps none
    overlay: Path | None = None  # folder of a PNG file for each frame; None draws none
    fresh: bool = False  # perceive frames again whose results are there already

    def __post_init__(self) -> None:
        if not self.paths:
            raise ValueError(
                "at least one frame is required, got none: name its file after `binpick perceive`, or a "
                "folder by --frames"
            )
        stems: dict[str, Path] = {}
        for path in self.paths if self.out is not None or self.overlay is not None else ():
            if path.stem in stems:
                raise ValueError(
                    f"the results of {stems[path.stem]} and {path} would have the same name {path.stem}: perceive them "
                    "into folders of their own"
                )
            stems[path.stem] = path
        if len(self.paths) > 1 and self.source.grey is not None and STEM not in self.source.grey:
            raise ValueError(
                f"several frames need a grey image each, got {self.source.grey!r}: write {STEM} for the frame's name"
            )

    def require_files(self) -> None:
        """Check that there is something to read, before seconds are spent on the network.

        Raises:
            FileNotFoundError: None of the frames exists, or none of their grey images.
        """
        if not any(path.exists() for path in self.paths):
            require_file(self.paths[0])
        greys = [Path(grey) for grey in map(self.source.grey_of, self.paths) if grey is not None]
        if greys and not any(grey.exists() for grey in greys):
            raise FileNotFoundError(f"there is no grey image {greys[0]}: check --grey")

    def numbers(self, path: Path) -> Path | None:
        """Return the JSON file of a frame."""
        return None if self.out is None else self.out / f"{path.stem}_poses.json"

    def pictures(self, path: Path) -> list[Path]:
        """Return the PNG files of a frame."""
        return [folder / f"{path.stem}_poses.png" for folder in (self.out, self.overlay) if folder is not None]


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameOutcome:
    """What became of a frame.

    Attributes:
        path: File of the frame.
        values: Record of the frame as JSON values; None if it could not be read.
        lines: What to print about it; the error of a frame that could not be read.
        resumed: Whether its results were there already.
        record: What was found in the frame; None if it could not be read, or was there already.
    """

    path: Path
    values: Values | None
    lines: tuple[str, ...]
    resumed: bool = False
    record: FrameRecord | None = None


def perceive_frames(
    job: FrameJob, perceiver: FramePerceiver, finder: GraspFinder | None = None
) -> Iterator[FrameOutcome]:
    """Yield the outcome of each frame, once its files are written.

    Args:
        job: Frames and folders.
        perceiver: Perception of the part.
        finder: Search for grasps on the parts found; None searches none.

    Raises:
        ValueError: The folder holds results of other options, another part or another network.
    """
    if job.out is not None:
        ensure_same_config(job.out / "config.json", _configuration(job, perceiver, finder), "poses", assumed=OLDER)
    for path in job.paths:
        yield _outcome(job, path, perceiver, finder)


def save_records(path: Path, outcomes: Sequence[FrameOutcome]) -> None:
    """Write the records of frames, the frames that could not be read, and where they come from, as a JSON file."""
    unread = [{"frame": str(each.path), "error": "\n".join(each.lines)} for each in outcomes if each.values is None]
    values = {
        "version": VERSION,
        "frames": [each.values for each in outcomes if each.values is not None],
        "unread": unread,
        "command": command_line(),
        "git_commit": git_commit(),
        "versions": versions(),
    }
    write_atomically(path, json_text(values))


def _outcome(job: FrameJob, path: Path, perceiver: FramePerceiver, finder: GraspFinder | None) -> FrameOutcome:
    """Return the outcome of a frame: its results if they are there and of these files, otherwise new ones."""
    # Before the frame is read: where a file changes meanwhile, the next call sees that it did.
    inputs = job.source.digests(path) if job.out is not None else {}
    values = _stored(job, path)
    if values is None:
        return _perceived(job, path, perceiver, finder, inputs)
    changed = changes(values.get(INPUTS), inputs)
    if changed is None:
        found = sum(pose["verified"] for pose in values["poses"])
        line = f"{path}: already there, {found} verified poses in {job.numbers(path)}"
        return FrameOutcome(path=path, values={**values, "frame": str(path)}, lines=(line,), resumed=True)
    again = _perceived(job, path, perceiver, finder, inputs)
    if again.values is None:
        return again
    return replace(again, lines=(f"{path}: perceived again, since {changed}", *again.lines))


def _perceived(
    job: FrameJob,
    path: Path,
    perceiver: FramePerceiver,
    finder: GraspFinder | None,
    inputs: dict[str, str | None],
) -> FrameOutcome:
    try:
        frame, reading = job.source.read(path)
        seen = perceiver.perceive(frame)
        grasps = None if finder is None else _grasps(frame, seen, finder)
        record = FrameRecord(path=path, frame=frame, reading=reading, seen=seen, perceiver=perceiver, grasps=grasps)
        pictures = job.pictures(path)
        picture = draw_poses(record) if pictures else None
    # One frame's failure must not lose the others. ModuleNotFoundError: a missing extra.
    except (ValueError, ArithmeticError, OSError, ModuleNotFoundError, cv2.error) as error:
        return FrameOutcome(path=path, values=None, lines=(str(error),))
    if picture is not None:
        for file in pictures:
            save_picture(picture, file)
    values = {**record.values(), INPUTS: inputs} if inputs else record.values()
    outcome = FrameOutcome(path=path, values=values, lines=tuple(frame_lines(record)), record=record)
    numbers = job.numbers(path)
    if numbers is not None:  # last: with it, the frame is finished
        save_records(numbers, [outcome])
    return outcome


def _grasps(frame: Frame, seen: Perception, finder: GraspFinder) -> list[FrameGrasp]:
    workspace = workspace_of_depth(frame) if seen.workspace is None else seen.workspace
    corrected = frame if seen.T_world_cam is None else replace(frame, T_world_cam=seen.T_world_cam)
    return finder.find(corrected, workspace, seen.poses)


def _stored(job: FrameJob, path: Path) -> Values | None:
    """Return the record of a frame whose files are all there; None if one is missing or damaged."""
    numbers = job.numbers(path)
    if job.fresh or numbers is None or not all(file.exists() for file in (numbers, *job.pictures(path))):
        return None
    try:
        content: Any = json.loads(numbers.read_text(encoding="utf-8"))
        (values,) = content["frames"]
        for pose in values["poses"]:
            pose["verified"]  # what a damaged file may lack, and an older one in the next line
        values["part"]["origin_in_file"]
    except (ValueError, KeyError, TypeError):
        return None
    return values if content.get("version") == VERSION and isinstance(values, dict) else None


def _configuration(job: FrameJob, perceiver: FramePerceiver, finder: GraspFinder | None) -> Values:
    part, workspace = perceiver.part, perceiver.workspace
    asked: Values = {}
    if job.folder is not None:
        asked["folder"] = str(job.folder.resolve())
    if finder is not None:
        base = None if finder.reach is None else finder.reach.T_world_base.tolist()
        asked["grasps"] = {"jaw": finder.jaw, "T_world_base": base}
    return {
        "part": part.name,
        "shape": [round(value, 9) for value in shape_signature(part)],
        "symmetry_order": str(part.symmetry.order),
        "weights": perceiver.weights.sha256,
        "T_world_bin": None if workspace is None else workspace.T_world_bin.tolist(),
        "inner_size": None if workspace is None else workspace.inner_size.tolist(),
        "measure_bin": perceiver.bin.measure,
        "trust": perceiver.bin.trust,
        "find_bin": perceiver.bin.find,
        "size_to_find": None if perceiver.bin.inner_size is None else perceiver.bin.inner_size.tolist(),
        **job.source.values(),
        **asked,
    }

"""The files of frames in a folder: what is a frame, and what belongs to one."""

import json
from pathlib import Path

from perception.capture import is_recording
from perception.capture.text_files import read_text

STEM = "{stem}"  # stands for the frame's file name without its suffix
SUFFIXES = (".png", ".tif", ".tiff", ".exr", ".npy", ".npz", ".pcd", ".ply")  # formats of one frame a file
_FRAME_KEYS = {"depth", "grey", "K"}  # keys of the JSON file of a frame, which names the files of its images


def frames_in(folder: Path, *, grey: str | None = None, calibration: Path | None = None) -> tuple[Path, ...]:
    """Return the files of the frames in a folder, in the order of their names; subfolders are not searched.

    Left out are files of other suffixes, calibrations, grey images that the pattern names, and the images that the
    JSON file of a frame names. A damaged JSON file counts as a frame, so that it is reported.

    Args:
        folder: Folder of the frames.
        grey: Path of the grey images, with {stem} for the name of the frame's file; None: none.
        calibration: File of the calibration; None if it is not in the folder.

    Raises:
        FileNotFoundError: There is no such folder.
        ValueError: It holds no frame.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}: give one by --frames, or name files of frames")
    found: list[Path] = []
    parts_of_frames: set[Path] = set()
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() == ".json":
            images = images_of_frame(path)
            if images is not None:
                found.append(path)
                parts_of_frames.update(images)
        elif path.suffix.lower() in SUFFIXES or is_recording(path):
            found.append(path)
    if calibration is not None:
        parts_of_frames.add(calibration.resolve())
    if grey is not None:
        parts_of_frames.update(Path(grey.replace(STEM, path.stem)).resolve() for path in found)
    frames = tuple(path for path in found if path.resolve() not in parts_of_frames)
    if not frames:
        raise ValueError(
            f"{folder} must hold frames ({', '.join(SUFFIXES)}, recordings, or JSON files of write_frame), got none"
        )
    return frames


def images_of_frame(path: Path) -> set[Path] | None:
    """Return the images that a JSON file of a frame names; None for a JSON file of something else."""
    try:
        content = json.loads(read_text(path))
    except (ValueError, OSError):
        return set()
    if not (isinstance(content, dict) and set(content) >= _FRAME_KEYS):
        return None
    try:
        return {path.with_name(str(content[key])).resolve() for key in ("depth", "grey")}
    except ValueError:  # no name of a file beside it, which reading refuses
        return set()

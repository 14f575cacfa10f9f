"""Poses in the results format of the BOP challenge, a CSV file that its toolkit evaluates."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perception.geometry import Floats, make_transform
from perception.runtime.files import write_atomically
from policies.frames.frame_record import Values
from policies.frames.job import FrameOutcome

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")


@dataclass(frozen=True, kw_only=True)
class BopNames:
    """Numbers that a BOP data set gives to the part and the scene."""

    obj_id: int = 1  # number of the part's model
    # number of the scene; None: the folder of BOP's layout SCENE/depth/IMAGE.png, otherwise 1
    scene_id: int | None = None

    def __post_init__(self) -> None:
        if self.obj_id < 0:
            raise ValueError(f"obj_id must not be negative, got {self.obj_id}")
        if self.scene_id is not None and self.scene_id < 0:
            raise ValueError(f"scene_id must not be negative, got {self.scene_id}")


def save_bop_results(path: Path, outcomes: Sequence[FrameOutcome], names: BopNames | None = None) -> None:
    """Write the verified poses of frames in the format of the BOP challenge.

    The format is that of ``bop_toolkit_lib.inout.save_bop_results``: rotations row by row, translations in
    millimetres, times of a whole image in seconds. Poses are those of the model as its file has it, whose origin is
    not that of the part frame. Images are numbered by the names of their files where all of these are numbers,
    otherwise from 0 in the order given. Frames without a pose, and those that could not be read, have no row.

    Args:
        path: CSV file; the toolkit wants a name such as ``METHOD_DATASET-SPLIT.csv``.
        outcomes: What became of the frames.
        names: Numbers of part and scene; the defaults if None.

    Raises:
        ValueError: Two frames would have the same numbers.
    """
    names = names or BopNames()
    numbers = image_numbers([outcome.path for outcome in outcomes], names.scene_id)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for (scene, image), outcome in zip(numbers, outcomes, strict=True):
        if outcome.values is not None:
            writer.writerows(_rows(outcome.values, scene, image, names.obj_id))
    write_atomically(path, text.getvalue())


def image_numbers(paths: Sequence[Path], scene_id: int | None = None) -> list[tuple[int, int]]:
    """Return the numbers of the scene and the image of each frame.

    Args:
        paths: Files of the frames.
        scene_id: Number of the scene; None to read it from BOP's layout.

    Raises:
        ValueError: Two frames would have the same numbers.
    """
    named = all(path.stem.isdecimal() for path in paths)
    numbers = [
        (_scene_of(path) if scene_id is None else scene_id, int(path.stem) if named else position)
        for position, path in enumerate(paths)
    ]
    seen: dict[tuple[int, int], Path] = {}
    for number, path in zip(numbers, paths, strict=True):
        if number in seen:
            raise ValueError(
                f"{seen[number]} and {path} would both be image {number[1]} of scene {number[0]}: write them into BOP "
                "files of their own"
            )
        seen[number] = path
    return numbers


def _scene_of(path: Path) -> int:
    """Return the number of the folder above ``depth``, as in BOP's layout; otherwise 1."""
    scene = path.absolute().parent.parent.name
    return int(scene) if path.absolute().parent.name == "depth" and scene.isdecimal() else 1


def _rows(values: Values, scene: int, image: int, obj_id: int) -> list[tuple[object, ...]]:
    """Return a row for each verified pose of a frame's record."""
    T_part_file = make_transform(translation=-np.array(values["part"]["origin_in_file"]))
    seconds = f"{sum(values['ms'].values()) / 1000:.6f}"
    rows: list[tuple[object, ...]] = []
    for pose in values["poses"]:
        if pose["verified"]:
            T: Floats = np.array(pose["T_cam_part"]) @ T_part_file
            R, t = _text(T[:3, :3].ravel(), 9), _text(1000 * T[:3, 3], 6)
            rows.append((scene, image, obj_id, f"{pose['score']:.6f}", R, t, seconds))
    return rows


def _text(numbers: Floats, digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in numbers.tolist())

"""Files of points alone: XYZ, text with labels, PLY and PCD."""

import logging
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perception.capture.cloud import measured
from perception.capture.damage import decoding
from perception.capture.pcd import read_pcd
from perception.capture.ply import read_ply
from perception.capture.text_files import read_text
from perception.geometry import Floats, require_shape
from perception.instance import Instance, labels_of
from perception.metrics.matching import SceneTruth
from perception.runtime.files import write_atomically

TEXTS = (".xyz", ".txt", ".csv", ".asc", ".pts")  # suffixes of text files
LEAST = 3  # number of points of the smallest cloud
_LARGEST = 2**31 - 1  # label
_SPACES = re.compile(r"(?<!,)\s+(?!,)")  # spaces beside a comma belong to it
_DECIMAL = re.compile(r"[+-]?[0-9]*,?[0-9]*([eE][+-]?[0-9]+)?|[+-]?(nan|inf)", re.IGNORECASE)
_WHOLE = re.compile(r"[+-]?[0-9]+")
_FRACTION = re.compile(r"0[0-9]+")  # whole number that is what follows a decimal comma
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False, kw_only=True)
class LabelledPoints:
    """Points of a file, and their labels where it has any.

    Attributes:
        points: (N, 3) points in the file's unit; those that were not measured are NaN.
        labels: (N,) int64 part of each point, -1 for none; None if the file has no labels.
    """

    points: Floats
    labels: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        require_shape("points", self.points, (None, 3))
        if self.labels is not None:
            require_shape("labels", self.labels, (len(self.points),))

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(N,) mask of the points that are finite and not at the origin."""
        return measured(self.points)

    def truth(self) -> SceneTruth | None:
        """Return the ground truth of the measured points, each part of which counts; None without labels."""
        if self.labels is None:
            return None
        labels = self.labels[self.measured]
        parts, ids = np.unique(labels[labels >= 0], return_inverse=True)
        instance_ids = np.full(len(labels), -1, np.int64)
        instance_ids[labels >= 0] = ids
        count = len(parts)
        return SceneTruth(
            instance_ids=instance_ids, class_of_instance=np.zeros(count, np.int64), ignored=np.zeros(count, np.bool_)
        )


def read_points(path: Path) -> LabelledPoints:
    """Read a cloud of points.

    Text has a point in each line, ``x y z``, ``x y z label`` or ``x y z score label``, separated by spaces, tabs,
    commas or semicolons. Commas within numbers that semicolons, tabs or spaces separate are decimal points
    (``0,1;0,2;0,3``). Labels count from 0, and negative ones stand for no part. Of lines of six or more numbers, such
    as colours or normals, the first three are read. Empty lines, comments (``#`` and ``//``) and a line of names at
    the top are skipped. So is a first line with one number, the number of points, which PTS files have: the fourth of
    four numbers is then an intensity, and no label.

    Args:
        path: PLY or PCD file, or text.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged, has another suffix, holds fewer than 3 measured points, or another number of
            points than its first line says.
    """
    suffix = path.suffix.lower()
    if suffix in (".ply", ".pcd"):
        with decoding(path):
            cloud = read_ply(path) if suffix == ".ply" else read_pcd(path)
        found = LabelledPoints(points=cloud.points.reshape(-1, 3))
    elif suffix in TEXTS:
        found = _text(path)
    else:
        raise ValueError(f"{path.name} must be a .ply, .pcd or text file ({', '.join(TEXTS)}), got {suffix or 'none'}")
    points = np.where(found.measured[:, None], found.points, np.nan)
    if (count := int(found.measured.sum())) < LEAST:
        raise ValueError(f"{path.name} must hold at least {LEAST} measured points, got {count} of {len(points)}")
    return LabelledPoints(points=points, labels=found.labels)


def write_labels(path: Path, points: Floats, instances: list[Instance]) -> None:
    """Write a line ``x y z score label`` for each point, atomically; :func:`read_points` reads it.

    Args:
        path: File to write.
        points: (N, 3) points.
        instances: Groups of the points. A point of none has score 0 and label -1.
    """
    labels = labels_of(instances, len(points))
    scores = np.append([instance.score for instance in instances], 0.0)[labels]
    lines = [
        f"{x:.9g} {y:.9g} {z:.9g} {score:.4f} {label}"
        for (x, y, z), score, label in zip(points.tolist(), scores.tolist(), labels.tolist(), strict=True)
    ]
    write_atomically(path, "\n".join(["# x y z score label", *lines, ""]))


def _words(line: str) -> list[str]:
    """Return the words of a line; commas between them separate, and those within them are decimal points.

    Raises:
        ValueError: Commas are both, or cannot be told apart.
    """
    if "," not in line:
        return line.replace(";", " ").split()
    fields = line.split(";") if ";" in line else _SPACES.split(line.strip())
    fields = [field.strip() for field in fields if field.strip()]
    several = any(field.count(",") > 1 for field in fields)  # no number has two commas: they separate
    if several or len(fields) < 2 or not any("," in field for field in fields):
        words = line.replace(",", " ").replace(";", " ").split()
        if all(_WHOLE.fullmatch(word) for word in words) and any(_FRACTION.fullmatch(word) for word in words):
            raise ValueError("commas cannot be both decimal points and separators")  # 0,05,0,10,0,90
        return words
    if not all(_DECIMAL.fullmatch(field) for field in fields):
        raise ValueError("commas must be decimal points or separators, not both")
    return [field.replace(",", ".") for field in fields]


def _text(path: Path) -> LabelledPoints:
    rows: list[list[float]] = []
    counted: float | None = None  # number of points that the file says it holds
    skipped: str | None = None  # first line without numbers
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        content = line.split("#")[0].split("//")[0]
        if not content.strip(" \t,;"):
            continue
        where, shown = f"line {number} of {path.name}", repr(line.strip()[:60])
        named = not rows and any(letter.isalpha() for letter in content)
        try:
            row = [float(word) for word in _words(content)]
        except ValueError as error:
            if not named:
                reason = f" ({error})" if "commas" in str(error) else ""
                raise ValueError(f"{where} must be numbers{reason}, got {shown}: write 0.1 0.2 0.3") from None
            _log.info("%s: line %d is skipped: %s", path.name, number, line.strip()[:60])
            skipped = skipped or shown
            continue
        if len(row) == 1 and not rows and counted is None:
            counted = row[0]
            if not (counted >= 0 and counted == np.floor(counted) < np.inf):
                raise ValueError(f"{where} must be the number of points, got {shown}")
            continue
        if len(row) == 1 and counted == len(rows) > 0 and len(rows[0]) > 1:
            raise ValueError(
                f"{path.name} must hold one scan, got a second one of {row[0]:g} points from line {number} on, "
                f"behind the {len(rows)} points of the first: split the file there, or, if both are in one "
                "frame, remove the line and state the number of all points in the first one"
            )
        if rows and len(row) != len(rows[0]):
            raise ValueError(f"{where} must hold {len(rows[0])} numbers as the lines before, got {len(row)}")
        rows.append(row)
    if not rows and skipped is not None:
        raise ValueError(f"{path.name} must hold lines of numbers x y z, got none: its first line is {skipped}")
    width = len(rows[0]) if rows else 3
    values = np.array(rows, np.float64).reshape(-1, width)
    if width < 3:
        raise ValueError(
            f"the lines of {path.name} must be x y z, x y z label or x y z score label, got {width} numbers"
        )
    if counted is not None and counted != len(rows):
        raise ValueError(f"{path.name} must hold {counted:g} points, as its first line says, got {len(rows)}")
    if counted is not None and width == 4:
        _log.info(
            "%s: the fourth number of each point is taken for an intensity, as its first line is a count", path.name
        )
    if width not in (4, 5) or (counted is not None and width == 4):
        return LabelledPoints(points=values[:, :3])
    labels = values[:, -1]
    if not np.array_equal(labels, np.round(labels)) or np.abs(labels).max(initial=0) > _LARGEST:
        raise ValueError(
            f"the last of {width} numbers in the lines of {path.name} is the label and must be whole, got "
            f"{labels[(labels != np.round(labels)) | (np.abs(labels) > _LARGEST)][0]}: leave other values out"
        )
    return LabelledPoints(points=values[:, :3], labels=np.maximum(labels, -1).astype(np.int64))

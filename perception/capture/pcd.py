"""Point clouds in PCD files (version 0.6 and 0.7): ascii, binary and binary_compressed.

Source: "The PCD (Point Cloud Data) file format", documentation of the Point Cloud Library.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perception.capture._decoding_kernels import decompress_lzf
from perception.capture.cloud import Cloud
from perception.capture.colours import grey_of_channels, grey_of_packed
from perception.capture.text_files import as_utf8, floats_of
from perception.geometry import Floats, make_transform, matrix_from_quat

KINDS = {"F": "f", "I": "i", "U": "u"}
SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
IDENTITY = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


@dataclass(frozen=True, kw_only=True)
class PcdHeader:
    """Header of a PCD file.

    Attributes:
        names: Name of each field.
        types: Type of each field's numbers, little-endian.
        counts: How many numbers each field has in a point.
        width: Points in a row, or all of them.
        height: Rows; 1 for an unorganised cloud.
        viewpoint: Translation and quaternion wxyz of the sensor's pose.
        data: Encoding of the points.
        start: Offset of the first byte behind the header.
    """

    names: list[str]
    types: list[np.dtype[np.generic]]
    counts: list[int]
    width: int
    height: int
    viewpoint: list[float]
    data: str
    start: int

    @property
    def points(self) -> int:
        """Number of points."""
        return self.width * self.height


def read_pcd(path: Path) -> Cloud:
    """Read a PCD file.

    Args:
        path: File with the fields x, y and z, as float or double.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The header or the points are not those of a PCD file.
    """
    content = as_utf8(path.read_bytes(), path.name)
    header = parse_header(content, path.name)
    body = content[header.start :]
    if header.data == "ascii":
        fields = _ascii_fields(header, body, path.name)
    elif header.data == "binary":
        fields = _binary_fields(header, body, path.name)
    else:
        fields = _compressed_fields(header, body, path.name)
    points = np.stack([fields[axis][:, 0].astype(np.float64) for axis in "xyz"], axis=-1)
    shape = (header.height, header.width)
    grey = _grey(fields)
    return Cloud(
        points=points.reshape(*shape, 3),
        grey=None if grey is None else grey.reshape(shape),
        viewpoint=_pose(header.viewpoint, path.name),
    )


def parse_header(content: bytes, name: str) -> PcdHeader:
    """Return the header of a PCD file.

    Args:
        content: The file's bytes.
        name: Name of the file, for messages.

    Raises:
        ValueError: A line is missing or contradicts another one.
    """
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        end = content.find(b"\n", start)
        if end < 0 or end - start > 100_000:
            raise ValueError(f"{name} must have the header of a PCD file up to DATA, got {sorted(entries)}")
        words = content[start:end].decode("ascii", "replace").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    missing = [key for key in ("FIELDS", "SIZE", "TYPE") if key not in entries]
    if missing or not ("WIDTH" in entries or "POINTS" in entries):
        raise ValueError(f"{name} must state FIELDS, SIZE, TYPE and WIDTH, got {sorted(entries)}")
    try:
        return _header(entries, start, name)
    except IndexError as error:
        raise ValueError(f"{name}: each line of the header must have a value, got {entries}") from error


def _header(entries: dict[str, list[str]], start: int, name: str) -> PcdHeader:
    names, kinds = entries["FIELDS"], entries["TYPE"]
    sizes = [int(size) for size in entries["SIZE"]]
    counts = [int(count) for count in entries.get("COUNT", ["1"] * len(names))]
    if not len(names) == len(sizes) == len(kinds) == len(counts):
        raise ValueError(
            f"{name} must have a SIZE, TYPE and COUNT for each field, got {len(names)} fields, {len(sizes)} sizes, "
            f"{len(kinds)} types and {len(counts)} counts"
        )
    for field, kind, size in zip(names, kinds, sizes, strict=True):
        if size not in SIZES.get(kind, ()):
            raise ValueError(f"{name}: a TYPE and SIZE must be one of {SIZES}, got {kind} and {size} for {field}")
    if not {"x", "y", "z"} <= set(names):
        raise ValueError(f"{name} must have the fields x, y and z, got {names}")
    width = int(entries["WIDTH" if "WIDTH" in entries else "POINTS"][0])
    height = int(entries.get("HEIGHT", ["1"])[0])
    points = int(entries.get("POINTS", [str(width * height)])[0])
    if points != width * height:
        raise ValueError(f"{name}: POINTS must be WIDTH x HEIGHT = {width} x {height}, got {points}")
    if min(width, height) < 0 or min(counts) < 1:
        raise ValueError(f"{name}: WIDTH and HEIGHT must be 0 or more and each COUNT 1 or more, got {entries}")
    data = entries["DATA"][0]
    if data not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"{name}: DATA must be ascii, binary or binary_compressed, got {data!r}")
    types = [np.dtype(f"<{KINDS[kind]}{size}") for kind, size in zip(kinds, sizes, strict=True)]
    viewpoint = [float(number) for number in entries.get("VIEWPOINT", IDENTITY)]
    return PcdHeader(
        names=names, types=types, counts=counts, width=width, height=height, viewpoint=viewpoint, data=data, start=start
    )


def _ascii_fields(header: PcdHeader, body: bytes, name: str) -> dict[str, NDArray[np.generic]]:
    words = body.split()
    columns = sum(header.counts)
    if len(words) != header.points * columns:
        raise ValueError(
            f"{name} must hold {header.points} points of {columns} numbers, got {len(words)} numbers: is it complete?"
        )
    table = floats_of(words, name).reshape(header.points, columns)
    fields, column = {}, 0
    for field, kind, count in zip(header.names, header.types, header.counts, strict=True):
        part = table[:, column : column + count]
        # Integers of text may be NaN, too; they become 0. Nothing but x, y and z says what was measured.
        fields[field] = (np.nan_to_num(part) if kind.kind in "iu" else part).astype(kind)
        column += count
    return fields


def _binary_fields(header: PcdHeader, body: bytes, name: str) -> dict[str, NDArray[np.generic]]:
    layout = np.dtype(
        [(str(i), kind, (count,)) for i, (kind, count) in enumerate(zip(header.types, header.counts, strict=True))]
    )
    _require_bytes(name, len(body), header.points * layout.itemsize)
    table = np.frombuffer(body, layout, count=header.points)
    return {field: table[str(i)] for i, field in enumerate(header.names)}


def _compressed_fields(header: PcdHeader, body: bytes, name: str) -> dict[str, NDArray[np.generic]]:
    _require_bytes(name, len(body), 8)
    compressed, size = (int(length) for length in np.frombuffer(body, "<u4", count=2))
    _require_bytes(name, len(body) - 8, compressed)
    wanted = header.points * sum(t.itemsize * c for t, c in zip(header.types, header.counts, strict=True))
    if size != wanted:
        raise ValueError(f"{name} must hold {wanted} bytes for {header.points} points, got {size}")
    data, complete = decompress_lzf(np.frombuffer(body, np.uint8, count=compressed, offset=8), size)
    if not complete:
        raise ValueError(f"{name} must hold {size} bytes compressed by LZF, got a damaged stream: copy the file again")
    fields, start = {}, 0
    for field, kind, count in zip(header.names, header.types, header.counts, strict=True):  # one field after the other
        numbers = header.points * count
        fields[field] = np.frombuffer(data, kind, count=numbers, offset=start).reshape(header.points, count)
        start += numbers * kind.itemsize
    return fields


def _require_bytes(name: str, have: int, want: int) -> None:
    if have < want:
        raise ValueError(f"{name} must have {want} bytes behind its header, got {have}: is the file complete?")


def _grey(fields: dict[str, NDArray[np.generic]]) -> NDArray[np.uint8] | None:
    """Return the (N,) grey values of the packed colours or intensities."""
    for field in ("rgb", "rgba"):
        if field in fields and fields[field].dtype.itemsize == 4:
            return grey_of_packed(np.ascontiguousarray(fields[field][:, 0]).view(np.uint32))
    if {"r", "g", "b"} <= set(fields) and fields["r"].dtype == np.uint8:
        return grey_of_channels(*(fields[channel][:, 0] for channel in "rgb"))
    if "intensity" in fields and fields["intensity"].dtype == np.uint8:
        return np.array(fields["intensity"][:, 0], np.uint8)
    return None


def _pose(numbers: list[float], name: str) -> Floats | None:
    """Return the sensor's pose of a VIEWPOINT, None for the identity."""
    if len(numbers) != 7 or not np.isfinite(numbers).all() or not np.linalg.norm(numbers[3:]) > 0:
        raise ValueError(f"{name}: VIEWPOINT must be tx ty tz qw qx qy qz with a quaternion, got {numbers}")
    return None if numbers == IDENTITY else make_transform(matrix_from_quat(numbers[3:]), numbers[:3])

"""PCD files written byte by byte are read as PCL means them; damaged ones are refused."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from perception.capture._decoding_kernels import decompress_lzf
from perception.capture.pcd import read_pcd
from perception.geometry import make_transform, rotation_about
from tests.perception.capture.camera_files import HEIGHT, WIDTH, pcd_header, scene_points, written

XYZ = ("x y z", "4 4 4", "F F F")


def literals(data: bytes) -> bytes:
    """Return an LZF stream that copies every byte."""
    runs = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def compressed(data: bytes) -> bytes:
    stream = literals(data)
    return struct.pack("<II", len(stream), len(data)) + stream


def ascii_points(points: NDArray[Any]) -> bytes:
    return "\n".join(" ".join(f"{value:.9g}" for value in point) for point in points.reshape(-1, 3)).encode()


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("size", [4, 8])
def test_every_encoding_gives_the_same_points(tmp_path: Path, data: str, size: int) -> None:
    points = scene_points(f"<f{size}")
    body = {
        "ascii": ascii_points(points) if size == 4 else repr_points(points),
        "binary": points.tobytes(),
        "binary_compressed": compressed(points.reshape(-1, 3).T.tobytes()),
    }[data]
    cloud = read_pcd(written(tmp_path / "a.pcd", pcd_header("x y z", f"{size} " * 3, "F F F", data) + body))
    np.testing.assert_array_equal(cloud.points, points.astype(np.float64))
    assert cloud.points.shape == (HEIGHT, WIDTH, 3)
    assert cloud.organised
    assert np.count_nonzero(~cloud.measured) == 2
    assert cloud.grey is None
    assert cloud.viewpoint is None


def repr_points(points: NDArray[Any]) -> bytes:
    return "\n".join(" ".join(repr(float(value)) for value in point) for point in points.reshape(-1, 3)).encode()


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_a_field_of_several_numbers_moves_no_other_field(tmp_path: Path, data: str) -> None:
    points = scene_points("<f4").reshape(-1, 3)
    features = np.arange(len(points) * 5, dtype="<f4").reshape(-1, 5)
    header = pcd_header("x hist y z", "4 4 4 4", "F F F F", data, COUNT="1 5 1 1")
    table = np.column_stack([points[:, :1], features, points[:, 1:]])
    body = {
        "ascii": "\n".join(" ".join(f"{value:.9g}" for value in row) for row in table).encode(),
        "binary": table.astype("<f4").tobytes(),
        "binary_compressed": compressed(
            points[:, 0].tobytes() + features.tobytes() + points[:, 1].tobytes() + points[:, 2].tobytes()
        ),
    }[data]
    cloud = read_pcd(written(tmp_path / "a.pcd", header + body))
    np.testing.assert_array_equal(cloud.points.reshape(-1, 3), points.astype(np.float64))


def test_packed_colours_that_are_nan_hide_no_point(tmp_path: Path) -> None:
    points = scene_points("<f4").reshape(-1, 3)
    packed = np.full(len(points), 0xFFFF8000, "<u4")  # NaN as a float, orange as a colour
    table = np.column_stack([points, packed.view("<f4")])
    assert np.isnan(table[:, 3]).all()
    cloud = read_pcd(
        written(tmp_path / "a.pcd", pcd_header("x y z rgb", "4 " * 4, "F F F F", "binary") + table.tobytes())
    )
    assert np.count_nonzero(cloud.measured) == len(points) - 2
    assert cloud.grey is not None
    assert set(cloud.grey.ravel().tolist()) == {round(0.299 * 255 + 0.587 * 128)}


def test_colours_are_read_from_integers_and_channels(tmp_path: Path) -> None:
    points = scene_points("<f4").reshape(-1, 3)
    layout = np.dtype([("p", "<f4", 3), ("rgba", "<u4")])
    table = np.zeros(len(points), layout)
    table["p"], table["rgba"] = points, 0x00FF0000
    packed = pcd_header("x y z rgba", "4 4 4 4", "F F F U", "binary") + table.tobytes()
    layout = np.dtype([("p", "<f4", 3), ("c", "u1", 3)])
    separate = np.zeros(len(points), layout)
    separate["p"], separate["c"] = points, (255, 0, 0)
    channels = pcd_header("x y z r g b", "4 4 4 1 1 1", "F F F U U U", "binary") + separate.tobytes()
    layout = np.dtype([("p", "<f4", 3), ("i", "u1")])
    shades = np.zeros(len(points), layout)
    shades["p"], shades["i"] = points, 76
    intensity = pcd_header("x y z intensity", "4 4 4 1", "F F F U", "binary") + shades.tobytes()
    for content in (packed, channels, intensity):
        grey = read_pcd(written(tmp_path / "a.pcd", content)).grey
        assert grey is not None
        assert set(grey.ravel().tolist()) == {76}


def test_integers_of_text_may_be_nan(tmp_path: Path) -> None:
    rows = "\n".join(f"{x:.9g} {y:.9g} {z:.9g} nan" for x, y, z in scene_points().reshape(-1, 3))
    content = pcd_header("x y z rgba", "4 4 4 4", "F F F U", "ascii") + rows.encode()
    assert np.count_nonzero(read_pcd(written(tmp_path / "a.pcd", content)).measured) == WIDTH * HEIGHT - 2


def test_the_viewpoint_is_the_pose_of_the_sensor(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    header = pcd_header(*XYZ, "binary", VIEWPOINT=f"1 2 3 {half} 0 0 {half}")
    cloud = read_pcd(written(tmp_path / "a.pcd", header + scene_points("<f4").tobytes()))
    assert cloud.viewpoint is not None
    np.testing.assert_allclose(
        cloud.viewpoint, make_transform(rotation_about((0, 0, 1), np.pi / 2), (1, 2, 3)), atol=1e-12
    )


def test_files_of_older_versions_have_fewer_lines(tmp_path: Path) -> None:
    header = pcd_header(*XYZ, "binary", COUNT="", VIEWPOINT="", HEIGHT="", WIDTH="")
    cloud = read_pcd(written(tmp_path / "a.pcd", header + scene_points("<f4").tobytes()))
    assert cloud.points.shape == (1, WIDTH * HEIGHT, 3)
    assert not cloud.organised


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"FIELDS": ""}, r"must state FIELDS, SIZE, TYPE and WIDTH, got \["),
        ({"SIZE": "4 4"}, "must have a SIZE, TYPE and COUNT for each field, got 3 fields, 2 sizes"),
        ({"TYPE": "F F X"}, "a TYPE and SIZE must be one of .* got X and 4 for z"),
        ({"FIELDS": "x y u"}, r"must have the fields x, y and z, got \['x', 'y', 'u'\]"),
        ({"POINTS": "47"}, "POINTS must be WIDTH x HEIGHT = 8 x 6, got 47"),
        ({"DATA": "zip"}, "DATA must be ascii, binary or binary_compressed, got 'zip'"),
        ({"VIEWPOINT": "0 0 0 0 0 0 0"}, "VIEWPOINT must be tx ty tz qw qx qy qz with a quaternion"),
        ({"WIDTH": "-8", "POINTS": "-48"}, "WIDTH and HEIGHT must be 0 or more and each COUNT 1 or more, got"),
        ({"COUNT": "0 1 1"}, "WIDTH and HEIGHT must be 0 or more and each COUNT 1 or more, got"),
        ({"WIDTH": " "}, "each line of the header must have a value"),
    ],
)
def test_headers_that_contradict_themselves_are_refused(tmp_path: Path, changes: dict[str, str], text: str) -> None:
    header = pcd_header(*XYZ, **({"data": "binary"} | changes))
    with pytest.raises(ValueError, match=text):
        read_pcd(written(tmp_path / "a.pcd", header + scene_points("<f4").tobytes()))


@pytest.mark.parametrize(
    ("data", "body", "text"),
    [
        ("ascii", b"1 2 3", "must hold 48 points of 3 numbers, got 3 numbers"),
        ("binary", bytes(100), "must have 576 bytes behind its header, got 100: is the file complete"),
        ("binary_compressed", b"", "must have 8 bytes behind its header, got 0"),
        ("binary_compressed", struct.pack("<II", 900, 576), "must have 900 bytes behind its header, got 0"),
        ("binary_compressed", struct.pack("<II", 0, 570), "must hold 576 bytes for 48 points, got 570"),
        ("binary_compressed", struct.pack("<II", 2, 576) + b"\x00\x01", "must hold 576 bytes compressed by LZF"),
    ],
)
def test_damaged_points_are_refused(tmp_path: Path, data: str, body: bytes, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        read_pcd(written(tmp_path / "a.pcd", pcd_header(*XYZ, data) + body))


def test_a_file_without_a_header_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must have the header of a PCD file up to DATA, got \[\]"):
        read_pcd(written(tmp_path / "a.pcd", b"\x89PNG"))


def lzf(stream: list[int], size: int) -> tuple[bytes, bool]:
    out, complete = decompress_lzf(np.array(stream, np.uint8), size)
    return bytes(out), complete


def test_lzf_copies_runs_and_repeats_them() -> None:
    # three bytes; a run of 3 + 2 from two bytes back, overlapping itself; a long one of 9 + 4 from one byte back
    stream = [2, *b"abc", (3 << 5), 1, (7 << 5), 4, 0]
    assert lzf(stream, 21) == (b"abc" + b"bcbcb" + b"b" * 13, True)
    far = [*b"".join(bytes([31]) + bytes([i]) * 32 for i in range(9)), (1 << 5) | 1, 31]  # 256 + 31 + 1 back
    assert lzf(far, 9 * 32 + 3)[0][-3:] == b"\x00\x00\x00"


@pytest.mark.parametrize("stream", [[2, 1], [1 << 5], [7 << 5, 1], [0, 9, 1 << 5, 5], [0, 9, 6 << 5, 0], [0, 9]])
def test_lzf_never_reads_or_writes_outside(stream: list[int]) -> None:
    assert not lzf(stream, 4)[1]

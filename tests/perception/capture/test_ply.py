"""PLY files written byte by byte, with the two kinds of grid; damaged ones are refused."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perception.capture import read_frame_with_report
from perception.capture.ply import read_ply
from tests.perception.capture.camera_files import HEIGHT, WIDTH, K, scene_depth, scene_points, written

FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
GRID = f"obj_info num_cols {WIDTH}\nobj_info num_rows {HEIGHT}\n"


def header(kind: str, elements: str, info: str = GRID) -> bytes:
    return f"ply\nformat {kind} 1.0\ncomment by hand\n{info}{elements}end_header\n".encode()


def vertex_element(count: int, number: str = "float", colours: bool = False) -> str:
    lines = [f"property {number} {axis}" for axis in "xyz"]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue")] if colours else []
    return "\n".join([f"element vertex {count}", *lines, ""])


def encoded(points: Any, order: str, kind: str) -> bytes:
    if not order:
        return "\n".join(" ".join(repr(float(value)) for value in point) for point in points).encode() + b"\n"
    return bytes(points.astype(f"{order}{kind}").tobytes())


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize(("number", "kind"), [("float", "f4"), ("double", "f8"), ("float32", "f4")])
def test_a_vertex_for_each_cell(tmp_path: Path, form: str, number: str, kind: str) -> None:
    points = scene_points(kind).reshape(-1, 3)
    content = header(form, vertex_element(len(points), number)) + encoded(points, FORMATS[form], kind)
    cloud = read_ply(written(tmp_path / "a.ply", content))
    np.testing.assert_array_equal(cloud.points, points.astype(np.float64).reshape(HEIGHT, WIDTH, 3))
    assert cloud.organised
    assert np.count_nonzero(cloud.measured) == WIDTH * HEIGHT - 2


@pytest.mark.parametrize("form", FORMATS)
def test_a_grid_of_indices_behind_other_elements(tmp_path: Path, form: str) -> None:
    order = FORMATS[form]
    points = scene_points("f4").reshape(-1, 3)
    known = np.isfinite(points).all(axis=1)
    cells = np.where(known, np.cumsum(known) - 1, -1)
    elements = "element camera 1\nproperty int id\nproperty float zoom\n" + vertex_element(int(known.sum()))
    elements += f"element range_grid {len(cells)}\nproperty list uchar int vertex_indices\n"
    elements += "element face 1\nproperty list uchar int vertex_indices\n"
    if order:
        body = struct.pack(f"{order}if", 7, 1.5) + encoded(points[known], order, "f4")
        body += b"".join(b"\0" if cell < 0 else struct.pack(f"{order}Bi", 1, cell) for cell in cells)
    else:
        body = b"7 1.5\n" + encoded(points[known], order, "f4")
        body += "\n".join("0" if cell < 0 else f"1 {cell}" for cell in cells).encode()
    path = written(tmp_path / "a.ply", header(form, elements) + body)
    np.testing.assert_array_equal(read_ply(path).points, points.astype(np.float64).reshape(HEIGHT, WIDTH, 3))
    frame, report = read_frame_with_report(path)
    np.testing.assert_array_equal(frame.depth, scene_depth())
    np.testing.assert_allclose(frame.K, K, rtol=1e-5)
    assert report.source == "organised cloud"


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("grid", [True, False])
def test_colours_become_grey(tmp_path: Path, form: str, grid: bool) -> None:
    points = scene_points("f4").reshape(-1, 3)
    if FORMATS[form]:
        table = np.zeros(len(points), [("p", f"{FORMATS[form]}f4", 3), ("c", "u1", 3)])
        table["p"], table["c"] = points, (0, 255, 0)
        body = table.tobytes()
    else:
        body = "\n".join(f"{x} {y} {z} 0 255 0" for x, y, z in points).encode()
    content = header(form, vertex_element(len(points), colours=True), GRID if grid else "") + body
    cloud = read_ply(written(tmp_path / "a.ply", content))
    assert cloud.organised == grid
    assert cloud.grey is not None
    assert set(cloud.grey.ravel().tolist()) == {150}  # 0.587 x 255


def test_intensities_and_empty_cells(tmp_path: Path) -> None:
    elements = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty uchar intensity\n"
    elements += "element range_grid 4\nproperty list uchar int vertex_indices\n"
    content = header("ascii", elements, "obj_info num_cols 2\nobj_info num_rows 2\n") + b"1 2 3 99\n0\n0\n1 0\n0\n"
    cloud = read_ply(written(tmp_path / "a.ply", content))
    assert cloud.measured.tolist() == [[False, False], [True, False]]
    assert cloud.points[1, 0].tolist() == [1, 2, 3]
    assert cloud.grey is not None
    assert cloud.grey.tolist() == [[0, 0], [99, 0]]


ONE = vertex_element(1)
INDICES = "element range_grid {}\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"solid", "must begin with 'ply' and a header up to end_header, got b'solid'"),
        (b"ply\nend_header", "must hold vertices behind its header, got none"),
        (header("binary", ONE), "format must be one of ascii, binary_little_endian, binary_big_endian, got binary"),
        (header("ascii", "element vertex 1\nproperty float x\n"), r"with x, y and z, got \['vertex'\]"),
        (header("ascii", "element vertex\n"), "must be 'element NAME COUNT', got 'element vertex'"),
        (header("ascii", "element vertex 1.5\n"), "must be 'element NAME COUNT', got 'element vertex 1.5'"),
        (header("ascii", "element vertex 1\nproperty float\n"), "must have a type and a name, got 'property float'"),
        (header("ascii", "element vertex 1\nproperty list uchar int\n"), "got 'property list uchar int' in vertex"),
        (header("ascii", "element vertex 1\nproperty half x\n"), r"type must be one of .* got \['half'\]"),
        (
            header("ascii", "element vertex 1\nproperty float x\nproperty list uchar int n\n"),
            "a list must be the only property of its element, with a length of one byte, got .* in vertex",
        ),
        (header("binary_little_endian", vertex_element(-1)), "count of an element must be 0 or more, got -1 of vertex"),
        (header("ascii", vertex_element(2)) + b"1 2 3", "must hold 2 of vertex, but ends early"),
        (header("binary_big_endian", ONE) + b"1 2 3", "must hold 1 of vertex, but ends early"),
        (header("ascii", ONE + INDICES.format(3)) + b"1 2 3 0", "must hold 3 of range_grid, but ends early"),
        (header("ascii", ONE + INDICES.format(1)) + b"1 2 3 1", "must hold 1 of range_grid, but ends early"),
        (header("binary_little_endian", ONE + INDICES.format(1)) + bytes(12) + b"\1\0\0\0", "ends early"),
        (header("ascii", ONE) + b"1 2 3", "must have a vertex for each of its 8 x 6 cells .* got 1 vertices"),
        (header("ascii", ONE + INDICES.format(1)) + b"1 2 3 0", "must have num_cols x num_rows = 8 x 6 cells, got 1"),
        (header("ascii", ONE + INDICES.format(48)) + b"1 2 3 1 5" + b" 0" * 47, "must name vertices 0 to 0, got 5"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused(tmp_path: Path, content: bytes, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        read_ply(written(tmp_path / "a.ply", content))


@pytest.mark.parametrize("form", FORMATS)
def test_a_cloud_without_points_is_empty(tmp_path: Path, form: str) -> None:
    assert read_ply(written(tmp_path / "a.ply", header(form, vertex_element(0), ""))).points.shape == (1, 0, 3)

"""Point clouds in PLY files: ascii and binary, with or without the grid of a range scanner.

A grid is stated by ``obj_info num_cols`` and ``num_rows``. Its cells hold either every vertex in turn, row by row, or
in an element ``range_grid`` the index of one vertex or none.

Source: G. Turk, "The PLY Polygon File Format", and the range scans of the Stanford 3D Scanning Repository.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.capture._decoding_kernels import list_starts
from perception.capture.cloud import Cloud
from perception.capture.colours import grey_of_channels
from perception.capture.ply_header import PlyElement, PlyHeader, parse_ply_header
from perception.capture.text_files import as_utf8, floats_of
from perception.geometry import Floats

Columns = dict[str, NDArray[Any]]
COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
SHADES = ("intensity", "gray", "grey")


def read_ply(path: Path) -> Cloud:
    """Read a PLY file.

    Args:
        path: File whose vertices have x, y and z.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is no PLY file, is damaged, or states a grid that its vertices do not fill.
    """
    content = as_utf8(path.read_bytes(), path.name)
    header = parse_ply_header(content, path.name)
    vertices, cells = (_ascii if header.order == "" else _binary)(header, content[header.start :], path.name)
    points = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    grey = _grey(vertices)
    if header.grid is None:
        return Cloud(points=points[None], grey=None if grey is None else grey[None])
    width, height = header.grid
    if cells is None:
        if len(points) != width * height:
            raise ValueError(
                f"{path.name} must have a vertex for each of its {width} x {height} cells or an element range_grid, "
                f"got {len(points)} vertices"
            )
        cells = np.arange(len(points))
    if len(cells) != width * height:
        raise ValueError(
            f"range_grid of {path.name} must have num_cols x num_rows = {width} x {height} cells, got {len(cells)}"
        )
    if cells.max(initial=-1) >= len(points):
        raise ValueError(f"range_grid of {path.name} must name vertices 0 to {len(points) - 1}, got {cells.max()}")
    return _in_grid(points, grey, cells.reshape(height, width))


def _in_grid(points: Floats, grey: NDArray[np.uint8] | None, cells: NDArray[np.int64]) -> Cloud:
    """Return the cloud of the vertices that the (H, W) cells name; negative cells are empty."""
    filled = cells >= 0
    grid = np.full((*cells.shape, 3), np.nan)
    grid[filled] = points[cells[filled]]
    image = None
    if grey is not None:
        image = np.zeros(cells.shape, np.uint8)
        image[filled] = grey[cells[filled]]
    return Cloud(points=grid, grey=image)


def _ascii(header: PlyHeader, body: bytes, name: str) -> tuple[Columns, NDArray[np.int64] | None]:
    words = body.split()
    vertices: Columns = {}
    cells: NDArray[np.int64] | None = None
    at = 0
    for element in header.wanted:
        if element.is_list:
            starts = [at]
            for _ in range(element.count):
                if starts[-1] >= len(words):
                    break
                starts.append(starts[-1] + 1 + int(words[starts[-1]]))
            _require(name, element, len(starts) == element.count + 1 and starts[-1] <= len(words))
            at = starts[-1]
            if element.name == "range_grid":
                named = (int(words[start + 1]) if int(words[start]) else -1 for start in starts[:-1])
                cells = np.fromiter(named, np.int64, element.count)
            continue
        end = at + element.count * len(element.properties)
        _require(name, element, end <= len(words))
        if element.name == "vertex":
            table = floats_of(words[at:end], name).reshape(element.count, len(element.properties))
            for column, (key, kind) in enumerate(element.properties):
                numbers = table[:, column]
                vertices[key] = (np.nan_to_num(numbers) if kind[0] in "iu" else numbers).astype(kind)
        at = end
    return vertices, cells


def _binary(header: PlyHeader, body: bytes, name: str) -> tuple[Columns, NDArray[np.int64] | None]:
    vertices: Columns = {}
    cells: NDArray[np.int64] | None = None
    at, data = 0, np.frombuffer(body, np.uint8)
    for element in header.wanted:
        if element.is_list:
            item = np.dtype(f"{header.order}{element.properties[0][1]}")
            starts = list_starts(data, at, element.count, item.itemsize)
            _require(name, element, bool(starts[-1] >= 0))
            at = int(starts[-1])
            if element.name == "range_grid":
                starts = starts[:-1]
                filled = data[starts] > 0
                cells = np.full(element.count, -1, np.int64)
                held = data[starts[filled][:, None] + 1 + np.arange(item.itemsize)]
                cells[filled] = np.ascontiguousarray(held).view(item)[:, 0]
            continue
        layout = np.dtype([(key, np.dtype(f"{header.order}{kind}")) for key, kind in element.properties])
        end = at + element.count * layout.itemsize
        _require(name, element, end <= len(body))
        if element.name == "vertex":
            table = np.frombuffer(body, layout, count=element.count, offset=at)
            vertices = {key: table[key] for key, _ in element.properties}
        at = end
    return vertices, cells


def _require(name: str, element: PlyElement, complete: bool) -> None:
    if not complete:
        raise ValueError(f"{name} must hold {element.count} of {element.name}, but ends early: is the file complete?")


def _grey(vertices: Columns) -> NDArray[np.uint8] | None:
    """Return the (N,) grey values of 8-bit colours or intensities; None if there are none."""
    for channels in COLOURS:
        if all(channel in vertices and vertices[channel].dtype == np.uint8 for channel in channels):
            return grey_of_channels(*(vertices[channel] for channel in channels))
    for shade in SHADES:
        if shade in vertices and vertices[shade].dtype == np.uint8:
            return np.array(vertices[shade])
    return None

"""Headers of PLY files."""

from dataclasses import dataclass

TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2"},
    **{"uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, kw_only=True)
class PlyElement:
    """One element of a PLY file.

    Attributes:
        name: Name of the element.
        count: Number of its entries.
        properties: Name and numpy type of each property; of a list, the type of its items.
        is_list: Whether the element is one list with a length of one byte.
    """

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]
    is_list: bool


@dataclass(frozen=True, kw_only=True)
class PlyHeader:
    """Header of a PLY file.

    Attributes:
        order: Byte order as numpy writes it; empty for ascii.
        wanted: Elements up to the last one that a cloud needs.
        grid: Columns and rows that the file states; None if it states none.
        start: Offset of the first byte behind the header.
    """

    order: str
    wanted: tuple[PlyElement, ...]
    grid: tuple[int, int] | None
    start: int


def parse_ply_header(content: bytes, name: str) -> PlyHeader:
    """Return the header of a PLY file.

    Args:
        content: The file's bytes.
        name: Name of the file, for messages.

    Raises:
        ValueError: The header is incomplete, or holds what a cloud cannot be read from.
    """
    end = content.find(b"end_header")
    if not content.startswith(b"ply") or end < 0:
        raise ValueError(f"{name} must begin with 'ply' and a header up to end_header, got {content[:20]!r}")
    start = content.find(b"\n", end) + 1
    if start == 0:
        raise ValueError(f"{name} must hold vertices behind its header, got none: is the file complete?")
    lines = [line.split() for line in content[:end].decode("ascii", "replace").splitlines()]
    order = next((words[1] for words in lines if words[:1] == ["format"] and len(words) > 1), "none")
    if order not in ORDERS:
        raise ValueError(f"{name}: format must be one of {', '.join(ORDERS)}, got {order}")
    elements = _elements(lines, name)
    needed = [i for i, element in enumerate(elements) if element.name in ("vertex", "range_grid")]
    vertex = next((element for element in elements if element.name == "vertex"), None)
    if vertex is None or not {"x", "y", "z"} <= {key for key, _ in vertex.properties}:
        raise ValueError(f"{name} must have vertices with x, y and z, got {[element.name for element in elements]}")
    return PlyHeader(order=ORDERS[order], wanted=tuple(elements[: needed[-1] + 1]), grid=_grid(lines), start=start)


def _elements(lines: list[list[str]], name: str) -> list[PlyElement]:
    elements: list[PlyElement] = []
    for i, words in enumerate(lines):
        if words[:1] != ["element"]:
            continue
        if len(words) != 3 or not words[2].lstrip("-").isdecimal():
            raise ValueError(f"{name}: a line of an element must be 'element NAME COUNT', got {' '.join(words)!r}")
        rest = lines[i + 1 :]
        length = next((j for j, line in enumerate(rest) if line[:1] == ["element"]), len(rest))
        given = [line[1:] for line in rest[:length] if line[:1] == ["property"]]
        short = next((line for line in given if len(line) < (4 if line[:1] == ["list"] else 2)), None)
        if short is not None:
            raise ValueError(
                f"{name}: a property must have a type and a name, got {' '.join(['property', *short])!r} in {words[1]}"
            )
        lists = [line for line in given if line[0] == "list"]
        if lists and (len(given) > 1 or lists[0][1] not in ("uchar", "uint8", "char", "int8")):
            raise ValueError(
                f"{name}: a list must be the only property of its element, with a length of one byte, got {given} in "
                f"{words[1]}: save the points alone"
            )
        unknown = sorted({line[-2] for line in given} - set(TYPES))
        if unknown:
            raise ValueError(f"{name}: a property's type must be one of {sorted(TYPES)}, got {unknown}")
        if int(words[2]) < 0:
            raise ValueError(f"{name}: the count of an element must be 0 or more, got {words[2]} of {words[1]}")
        elements.append(
            PlyElement(
                name=words[1],
                count=int(words[2]),
                properties=tuple((line[-1], TYPES[line[-2]]) for line in given),
                is_list=bool(lists),
            )
        )
    return elements


def _grid(lines: list[list[str]]) -> tuple[int, int] | None:
    """Return the columns and rows that ``obj_info`` states."""
    stated = {words[1]: words[2] for words in lines if words[:1] == ["obj_info"] and len(words) == 3}
    if "num_cols" not in stated or "num_rows" not in stated:
        return None
    return int(stated["num_cols"]), int(stated["num_rows"])

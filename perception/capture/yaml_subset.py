"""Calibration files in YAML: nested mappings of numbers, text and lists of numbers.

The files of OpenCV's ``FileStorage`` and of ROS need no more. OpenCV's own reader refuses lists of ROS 2, whose items
are not indented.
"""

from typing import Any


def parse_yaml(text: str) -> dict[str, Any]:
    """Return the first document of a YAML text as dictionaries, lists, numbers and text.

    Args:
        text: Block mappings, block lists of scalars, and lists in brackets, also over several lines. Tags are ignored.

    Raises:
        ValueError: A line is none of these; the message names it.
    """
    return _mapping(_lines(text), 0)[0]


def _lines(text: str) -> list[tuple[int, str]]:
    """Return the indentation and the text of each line of the first document; brackets are joined to one line."""
    lines: list[tuple[int, str]] = []
    open_bracket = False
    for raw in text.splitlines():
        content = raw.split(" #")[0].strip()
        if content in ("---", "...") or content.startswith("%"):
            if lines:
                break
            continue
        if not content or content.startswith("#"):
            continue
        if open_bracket:
            lines[-1] = (lines[-1][0], f"{lines[-1][1]} {content}")
        else:
            lines.append((len(raw) - len(raw.lstrip()), content))
        open_bracket = lines[-1][1].count("[") > lines[-1][1].count("]")
    if open_bracket:
        raise ValueError(f"a list of a calibration in YAML must end with ']', got {lines[-1][1][:60]!r} up to the end")
    return lines


def _mapping(lines: list[tuple[int, str]], start: int) -> tuple[dict[str, Any], int]:
    """Return the mapping that begins at a line, and the index of the line after it."""
    values: dict[str, Any] = {}
    indent, i = (lines[start][0] if start < len(lines) else 0), start
    while i < len(lines) and lines[i][0] == indent and not lines[i][1].startswith("- "):
        key, colon, rest = lines[i][1].partition(":")
        if not colon:
            raise ValueError(f"a line of a calibration in YAML must be 'key: value', got {lines[i][1]!r}")
        rest = " ".join(word for word in rest.split() if not word.startswith("!"))
        i += 1
        if rest:
            values[_bare(key)] = _value(rest)
        elif i < len(lines) and lines[i][0] >= indent and lines[i][1].startswith("- "):
            items = lines[i][0]
            values[_bare(key)] = []
            while i < len(lines) and lines[i][0] == items and lines[i][1].startswith("- "):
                values[_bare(key)].append(_value(lines[i][1][2:].strip()))
                i += 1
        elif i < len(lines) and lines[i][0] > indent:
            values[_bare(key)], i = _mapping(lines, i)
        else:
            values[_bare(key)] = None
    if i < len(lines) and lines[i][0] > indent:
        raise ValueError(f"a line of a calibration in YAML must be 'key: value', got {lines[i][1]!r}")
    return values, i


def _bare(text: str) -> str:
    return text.strip().strip("'\"")


def _value(text: str) -> Any:
    if text.startswith("["):
        return [_value(item.strip()) for item in text.strip("[] ").split(",") if item.strip()]
    try:
        return float(text)
    except ValueError:
        return _bare(text)

"""What text files of meshes announce, compared with what they hold, and numbers that no reader takes."""

import re

_BEGINNING = 65_536  # length of the beginning of a file that is searched for decimal commas [bytes]
_NUMBER = rb"[-+]?\d+(?:,\d+)?(?:e[-+]?\d+)?"
_ROW = re.compile(rb"^(?:[ \t]*v(?:ertex)?)?[ \t]*((?:" + _NUMBER + rb"[ \t]+){2}" + _NUMBER + rb")", re.M | re.I)
_COMMA = re.compile(rb"\S*\d,\d\S*")


class RefusedError(ValueError):
    """What a file says is understood and cannot be taken; the text says what to do."""


def require_decimal_points(text: bytes) -> None:
    """Refuse a text whose coordinates have decimal commas.

    Raises:
        RefusedError: They have; the message shows a number.
    """
    begin = text[:_BEGINNING]
    rows = _ROW.finditer(begin) if b"," in begin else iter(())
    number = next((found for row in rows if (found := _COMMA.search(row.group(1))) is not None), None)
    if number is None:
        return
    comma = number.group().decode()
    raise RefusedError(
        f"its numbers must have decimal points, got decimal commas, such as {comma} for {comma.replace(',', '.')}: "
        "export it with decimal points, or replace the commas"
    )


def require_whole_off(text: bytes) -> None:
    """Refuse an OFF that holds fewer vertices or faces than it announces.

    Raises:
        RefusedError: It is truncated; the message names the numbers.
    """
    lines = [kept for line in text.splitlines() if (kept := line.partition(b"#")[0].strip())]
    words = lines[0].split() if lines else []
    counts = words[1:] if len(words) > 2 else lines[1].split() if len(lines) > 1 else []
    data = lines[1:] if len(words) > 2 else lines[2:]
    if len(counts) >= 2 and counts[0].isdigit() and counts[1].isdigit():
        _require_lines({"vertices": int(counts[0]), "faces": int(counts[1])}, data, listed=True)


def require_whole_ply(data: bytes) -> None:
    """Refuse a text PLY that holds fewer elements than its header announces; a binary one is not looked at.

    Raises:
        RefusedError: It is truncated; the message names the numbers.
    """
    header, _, body = data.partition(b"end_header")
    words = [line.split() for line in header.splitlines()]
    if [b"format", b"ascii"] not in [line[:2] for line in words]:
        return
    require_decimal_points(body)
    names = {b"vertex": "vertices", b"face": "faces"}
    counts: dict[str, int] = {}
    first, listed = False, False  # whether the next property is a face's first one, and whether that one is a list
    for line in words:
        if line[:1] == [b"element"] and len(line) == 3 and line[2].isdigit():
            counts[names.get(line[1], line[1].decode("utf-8", "replace"))] = int(line[2])
            first, listed = line[1] == b"face", False
        elif line[:1] == [b"property"] and first:
            first, listed = False, line[1:2] == [b"list"]
    _require_lines(counts, [kept for line in body.splitlines() if (kept := line.strip())], listed=listed)


def _require_lines(counts: dict[str, int], lines: list[bytes], *, listed: bool) -> None:
    """Refuse fewer lines than there are things, one a line.

    Args:
        counts: Number of things of each kind that are announced, in their order.
        lines: Lines of the file that hold them.
        listed: Whether the last kind's lines begin with the number of the values that follow.
    """
    announced = sum(counts.values())
    what = " and ".join(f"{count} {name}" for name, count in counts.items())
    advice = "export or copy it again"
    if len(lines) < announced:
        raise RefusedError(
            f"it is truncated: its header announces {what}, one a line, and {len(lines)} lines follow; {advice}"
        )
    last = lines[announced - 1].split() if announced else []
    if listed and last and last[0].isdigit() and len(last) - 1 < int(last[0]):
        raise RefusedError(
            f"it is truncated: the last one of {what} must have {int(last[0])} corners, got {len(last) - 1}; {advice}"
        )

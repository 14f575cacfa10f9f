"""Text of files in the encodings that programs write, and the numbers in it."""

import codecs
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from perception.geometry import Floats

# Byte order marks and the encodings that they stand for. That of UTF-32 begins with that of UTF-16.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)


def read_text(path: Path, *, kind: str = "text in UTF-8", advice: str = "save it as text") -> str:
    """Return the text of a file in UTF-8, or in UTF-16 or UTF-32 with a byte order mark, as Windows writes them.

    Bytes of another encoding, such as those of an accent in a comment, become U+FFFD.

    Args:
        path: File.
        kind: What the file must be, for messages.
        advice: What to do with a binary file, for messages.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file holds no text.
    """
    content = as_utf8(path.read_bytes(), path.name)
    if b"\0" in content:
        if _is_wide(content):
            raise ValueError(f"{path.name} must be {kind}, got UTF-16 without a byte order mark: save it as UTF-8")
        raise ValueError(f"{path.name} must be {kind}, got a binary file: {advice}")
    return content.decode("utf-8", errors="replace")


def _is_wide(content: bytes) -> bool:
    """Return whether every other byte of a text's beginning is 0, as in UTF-16 of Latin letters."""
    even, odd = content[:400:2], content[1:400:2]
    return (not even.strip(b"\0") and b"\0" not in odd) or (not odd.strip(b"\0") and b"\0" not in even)


def as_utf8(content: bytes, name: str) -> bytes:
    """Return the bytes of a file without its byte order mark, in UTF-8 if that stands for UTF-16 or UTF-32.

    Bytes without a mark are returned as they are: UTF-8, or not text.

    Args:
        content: Bytes of the file.
        name: Name of the file, for messages.

    Raises:
        ValueError: The bytes are not those of the encoding that the mark stands for.
    """
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            rest = content[len(mark) :]
            if encoding == "utf-8":
                return rest
            try:
                return rest.decode(encoding).encode()
            except UnicodeDecodeError as error:
                raise ValueError(
                    f"{name} must be text in {encoding.upper()}, as its first bytes say, got {error.reason} at byte "
                    f"{error.start}: save it as UTF-8"
                ) from error
    return content


def floats_of(words: Sequence[Any], name: str) -> Floats:
    """Return words of a text file as (N,) float64 numbers.

    Args:
        words: Words, as text or bytes.
        name: Name of the file, for messages.

    Raises:
        ValueError: A word is no number.
    """
    try:
        return np.array(words, np.float64)
    except ValueError:
        wrong = next(word for word in words if not _is_number(word))
        text = wrong.decode("utf-8", "replace") if isinstance(wrong, bytes) else str(wrong)
        comma = ": write decimal points in place of commas" if "," in text else ""
        raise ValueError(f"{name} must hold numbers, got {text[:60]!r}{comma}") from None


def _is_number(word: Any) -> bool:
    try:
        np.float64(word)
    except ValueError:
        return False
    return True

"""The compiled parser of raw points: bytes in, arrays out."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]

WHOLE, NOT_A_NUMBER, NOT_SIX, NO_COLOUR, OUT_OF_RANGE = range(5)  # results of parsing
LARGEST = 1e6  # largest absolute coordinate [m]

_SPACE, _TAB, _RETURN, _NEWLINE, _PLUS, _MINUS, _DOT, _0, _9 = 32, 9, 13, 10, 43, 45, 46, 48, 57
_DIGITS = 18  # number of digits that fit an int64; a float32 cannot resolve further ones
_POWERS = 10.0 ** np.arange(23)  # exact in float64


@njit(cache=True, nogil=True, error_model="numpy")
def _scaled(mantissa: int, exponent: int) -> float:
    """Return mantissa times 10 to the exponent, correctly rounded for up to 15 digits and 22 decimals."""
    if -22 <= exponent < 0:
        return mantissa / float(_POWERS[-exponent])
    if 0 <= exponent <= 22:
        return mantissa * float(_POWERS[exponent])
    return float(mantissa * 10.0 ** max(-400, min(400, exponent)))


@njit(cache=True, nogil=True, error_model="numpy")
def _number(text: Bytes, start: int) -> tuple[float, int, bool]:
    """Return the number at ``start``, the index behind it, and whether it is well-formed up to a blank or the end."""
    end, i = len(text), start
    negative = i < end and text[i] == _MINUS
    if i < end and (text[i] == _MINUS or text[i] == _PLUS):
        i += 1
    # Digits and the decimal point.
    mantissa, kept, seen, exponent, decimal = 0, 0, 0, 0, 0
    while i < end:
        byte = text[i]
        if _0 <= byte <= _9:
            seen += 1
            if kept < _DIGITS:
                mantissa = mantissa * 10 + (byte - _0)
                kept += mantissa > 0
                exponent -= decimal
            else:
                exponent += 1 - decimal
        elif byte == _DOT and decimal == 0:
            decimal = 1
        else:
            break
        i += 1
    if seen > 0 and i < end and (text[i] == 101 or text[i] == 69):  # e, E
        # The exponent after an e or E.
        i += 1
        sign = -1 if i < end and text[i] == _MINUS else 1
        if i < end and (text[i] == _MINUS or text[i] == _PLUS):
            i += 1
        power, seen = 0, 0
        while i < end and _0 <= text[i] <= _9:
            power = min(power * 10 + (text[i] - _0), 10_000)
            seen += 1
            i += 1
        exponent += sign * power
    ends = i >= end or text[i] in (_SPACE, _TAB, _RETURN, _NEWLINE)
    value = _scaled(mantissa, exponent)
    return (-value if negative else value), i, seen > 0 and ends


@njit(cache=True, nogil=True, error_model="numpy")
def _store(value: float, row: int, column: int, points: NDArray[np.float32], colours: Bytes) -> int:
    """Write a number of a line to its array; return the result of its check."""
    if column < 3:
        if not abs(value) <= LARGEST:
            return OUT_OF_RANGE
        points[row, column] = value
        return WHOLE
    if not (0 <= value <= 255 and value == np.floor(value)):
        return NO_COLOUR
    colours[row, column - 3] = np.uint8(value)
    return WHOLE


@njit(cache=True, nogil=True, error_model="numpy")
def parse_points(text: Bytes, points: NDArray[np.float32], colours: Bytes) -> tuple[int, int, int]:
    """Parse lines of x, y, z, red, green, blue; blank lines do not count.

    Args:
        text: (B,) uint8 bytes of the text.
        points: (L, 3) float32 array that receives the coordinates; L is at least the number of lines.
        colours: (L, 3) uint8 array that receives the colours.

    Returns:
        Number of points, result, and the number (from 1) of the first malformed line.
    """
    count, line, column, i, end = 0, 1, 0, 0, len(text)
    while i < end:
        byte = text[i]
        if byte == _NEWLINE:
            if 0 < column < 6:
                return count, NOT_SIX, line
            count += column == 6
            column = 0
            line += 1
            i += 1
        elif byte in (_SPACE, _TAB, _RETURN):
            i += 1
        else:
            value, i, good = _number(text, i)
            if not good:
                return count, NOT_A_NUMBER, line
            if column == 6:
                return count, NOT_SIX, line
            verdict = _store(value, count, column, points, colours)
            if verdict != WHOLE:
                return count, verdict, line
            column += 1
    if 0 < column < 6:
        return count, NOT_SIX, line
    return count + (column == 6), WHOLE, 0

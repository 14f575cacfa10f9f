"""Compiled kernels of file formats: bytes in, bytes or indices out."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


@njit(cache=True, nogil=True)
def decompress_lzf(source: Bytes, size: int) -> tuple[Bytes, bool]:
    """Return the ``size`` bytes that LZF compressed to ``source``, and whether the stream was complete.

    A control byte below 32 precedes that many bytes plus one, to be copied. Any other holds in its upper three bits the
    length less two of an earlier run (7: add the next byte), and in its lower five bits the upper part of its distance.

    Source: the format of liblzf 3.6, ``lzf_d.c``, by M. A. Lehmann.
    """
    out = np.zeros(size, np.uint8)
    i, o = 0, 0
    while i < len(source):
        control = int(source[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > len(source) or o + length > size:
                return out, False
            for _ in range(length):
                out[o] = source[i]
                i += 1
                o += 1
            continue
        length = control >> 5
        if i + (2 if length == 7 else 1) > len(source):
            return out, False
        if length == 7:
            length += int(source[i])
            i += 1
        length += 2
        start = o - ((control & 31) << 8) - int(source[i]) - 1
        i += 1
        if start < 0 or o + length > size:
            return out, False
        for k in range(length):  # byte by byte: a run may overlap what it writes
            out[o + k] = out[start + k]
        o += length
    return out, o == size


@njit(cache=True, nogil=True)
def list_starts(data: Bytes, start: int, cells: int, item_bytes: int) -> NDArray[np.int64]:
    """Return the (cells + 1,) offsets at which lists with a one-byte length begin; -1 from where the data ends early.

    Args:
        data: Bytes of the file.
        start: Offset of the first list.
        cells: Number of lists.
        item_bytes: Size of an item of a list.
    """
    starts = np.full(cells + 1, -1, np.int64)
    at = start
    for cell in range(cells):
        if at >= len(data):
            return starts
        starts[cell] = at
        at += 1 + int(data[at]) * item_bytes
    if at <= len(data):
        starts[cells] = at
    return starts

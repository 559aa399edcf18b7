"""PNG files of one channel of 16 bits, as depth is recorded, decoded in half the usual time."""

from __future__ import annotations

import struct

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from formats.kernels import compiled

_MAGIC = b"\x89PNG\r\n\x1a\n"
_HEAD = struct.Struct(">2I5B")
_GREY_16 = (16, 0, 0, 0, 0)  # bits, colour type, compression, filters, no interlace
_PASSED_OVER = {b"tEXt", b"tIME", b"pHYs"}  # chunks that leave the pixels as they are


def plain_grey_16(data: bytes) -> NDArray[np.uint16] | None:
    """Cells (H, W) of a PNG of 16 bits of grey; None where anything of it asks a closer look.

    That is where a sum is wrong, bytes are missing, or chunks are there that may change pixels
    (PNG specification, sections 5 and 9).
    """
    parts = _image_parts(data)
    if parts is None or len(parts[0]) != _HEAD.size:
        return None
    width, height, *kind = _HEAD.unpack(parts[0])
    if tuple(kind) != _GREY_16 or width * height == 0:
        return None
    rows = _inflated(b"".join(parts[1:]), height * (1 + 2 * width))
    if rows is None:
        return None
    cells = np.zeros((height + 1, 2 * width + 2), np.uint8)
    if not _unfiltered(np.frombuffer(rows, np.uint8).reshape(height, -1), cells):
        return None
    return cells[1:, 2:].view(">u2").astype(np.uint16)


def _image_parts(data: bytes) -> list[bytes] | None:
    """What the head and the chunks of pixels hold, where all is in order up to the end."""
    if data[:8] != _MAGIC or data[12:16] != b"IHDR":
        return None
    parts: list[bytes] = []
    at = 8
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        name = data[at + 4 : at + 8]
        if isal_zlib.crc32(data[at + 4 : end]).to_bytes(4, "big") != data[end : end + 4]:
            return None
        if name == b"IEND":
            return parts
        if name == b"IDAT" or (name == b"IHDR" and at == 8):
            parts.append(data[at + 8 : end])
        elif name not in _PASSED_OVER:
            return None
        at = end + 4
    return None


def _inflated(stream: bytes, size: int) -> bytes | None:
    """Exactly `size` bytes of a whole zlib stream."""
    inflater = isal_zlib.decompressobj()
    try:
        rows = inflater.decompress(stream, size + 1)
    except isal_zlib.IsalError:  # type: ignore[misc]  # isal declares an instance
        return None
    return bytes(rows) if inflater.eof and len(rows) == size else None


def _undo_filters(rows, cells):  # type: ignore[no-untyped-def]
    """Fills `cells`, which have a rim of a pixel above and to the left; False of unknown filters.

    Two bytes a pixel: each is reported by those two to the left (a), above (b) and both (c).
    """
    for row in range(rows.shape[0]):
        kind, reported, above, found = rows[row, 0], rows[row, 1:], cells[row], cells[row + 1]
        if kind > 4:
            return False
        if kind == 2:  # of all bytes at once; most rows are so
            for k in range(reported.shape[0]):
                found[k + 2] = reported[k] + above[k + 2]
            continue
        for byte in range(2):
            a, c = np.int64(0), np.int64(0)
            for k in range(byte, reported.shape[0], 2):
                b = np.int64(above[k + 2])
                if kind == 4:
                    to_a, to_b, to_c = abs(b - c), abs(a - c), abs(a + b - 2 * c)
                    least = min(to_a, to_b, to_c)
                    a = a if to_a == least else b if to_b == least else c
                elif kind == 3:
                    a = (a + b) >> 1
                elif kind == 0:
                    a = np.int64(0)
                a, c = (reported[k] + a) & 255, b
                found[k + 2] = a
    return True


_unfiltered = compiled(_undo_filters)

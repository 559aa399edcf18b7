"""JPEG, PNG and WebP files: their size from the head, their pixels within what may be claimed."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from formats.limits import limits
from mapmyworld.errors import MapError

_PNG, _JPEG = b"\x89PNG", b"\xff\xd8"
# JPEG segments that hold the size: all start-of-frame markers but DHT, JPG and DAC.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BARE = frozenset({0x00, 0x01, *range(0xD0, 0xD8), 0xFF})  # no segment follows
_SCAN, _MOST_SCANS = b"\xff\xda", 100  # each visits all pixels; a progressive file has some ten


def picture_size(data: bytes) -> tuple[int, int]:
    """Width and height of a PNG, JPEG or WebP file, from its head; 0, 0 where it holds none."""
    if data[:4] == _PNG and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data[8:15] == b"WEBPVP8" and len(data) >= 30:
        return _webp_size(data)
    frame = jpeg_frame(data)
    return (0, 0) if frame is None else frame[:2]


def jpeg_frame(data: bytes) -> tuple[int, int, int] | None:
    """Width, height and number of channels that a JPEG's head states; None where it does not.

    Found as decoders find it (ITU-T T.81, annex B.1.1), so that no head hides its size from us
    and not from them: they pass over what is no marker and over bytes that fill, and take a
    segment that is shorter than its own length for an empty one.
    """
    at = 2 if data[:2] == _JPEG else len(data)
    while (at := data.find(b"\xff", at) + 1) > 0 and at + 9 <= len(data):
        marker = data[at]
        if marker in _JPEG_FRAMES:
            height, width = struct.unpack_from(">2H", data, at + 4)
            return width, height, data[at + 8]
        if marker not in _BARE:
            at += 1 + max(int.from_bytes(data[at + 1 : at + 3], "big"), 2)
    return None


def _webp_size(data: bytes) -> tuple[int, int]:
    """Of the first chunk: extended, lossless or lossy (RFC 9649, section 2)."""
    if data[15:16] == b"X":
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    if data[15:16] == b"L":
        bits = int.from_bytes(data[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    width, height = (int.from_bytes(data[at : at + 2], "little") & 0x3FFF for at in (26, 28))
    return width, height


def is_16_bit_png(data: bytes) -> bool:
    """Grey of 16 bits: in the bags of robots, depth."""
    return data[:4] == _PNG and len(data) > 25 and data[24] == 16 and data[25] == 0


def is_grey(data: bytes) -> bool:
    """Whether a PNG or JPEG file holds one channel, by its head."""
    if data[:4] == _PNG:
        return len(data) > 25 and data[25] == 0
    frame = jpeg_frame(data)
    return frame is not None and frame[2] == 1


def claims_too_much(data: bytes) -> bool:
    """Whether a file claims a size that would fill the memory, or no size at all.

    OpenCV takes room for a chunk of a PNG, up to 4 GB, before it reads it; so each must be there.
    """
    width, height = picture_size(data)
    if not 0 < width * height <= limits().image_pixels:
        return True
    return data.count(_SCAN) > _MOST_SCANS if data[:2] == _JPEG else not _chunks_are_there(data)


def _chunks_are_there(data: bytes) -> bool:
    """Of a PNG: no chunk before the end is longer than the file (PNG specification, section 5)."""
    position = 8
    while data[:4] == _PNG and position + 8 <= len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        if length > len(data) - position - 8:
            return False
        if data[position + 4 : position + 8] == b"IEND":
            break
        position += 12 + length
    return True


def decoded_file(data: bytes, mode: int) -> NDArray[np.generic] | None:
    """What OpenCV decodes of a JPEG, PNG or WebP file in one of its modes.

    Grey (H, W) or (H, W, K) of K channels, blue first. None of one that is damaged or claims too
    much, and of every other kind of file.
    """
    import cv2

    if claims_too_much(data):
        return None
    try:
        cells = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    except cv2.error:
        return None
    return None if cells is None else np.asarray(cells)


def encoded_file(suffix: str, pixels: NDArray[np.generic], *options: int) -> bytes:
    """Grey (H, W) or (H, W, K) of K channels, blue first, as OpenCV writes a file of that name.

    Raises `MapError` where it cannot.
    """
    import cv2

    done, data = cv2.imencode(suffix, np.ascontiguousarray(pixels), options)
    if not done:
        raise MapError(f"an image of shape {pixels.shape} cannot be written as {suffix}")
    return bytes(data)

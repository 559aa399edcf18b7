"""The payload of ROS's compressedDepth transport: a header, then PNG or RVL.

Twelve bytes of header (format, two quantisation parameters), then the file. 16UC1 is millimetres;
32FC1 is inverse depth, quantised: depth = A / (value - B).
RVL: A. D. Wilson, "Fast Lossless Depth Image Compression" (2017).
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from formats.limits import limits
from formats.picture_files import decoded_file, picture_size
from mapmyworld.errors import LogError

_HEADER = struct.Struct("<iff")
_RVL_SIZE = struct.Struct("<II")


def decode_compressed_depth(data: bytes, encoding: str, described: str) -> NDArray[np.generic]:
    """Depth (H, W): uint16 millimetres for 16UC1, float32 metres (NaN = none) for 32FC1."""
    if len(data) <= _HEADER.size:
        raise LogError("a compressedDepth image without content")
    _, a, b = _HEADER.unpack_from(data)
    payload = data[_HEADER.size :]
    values = decode_rvl(payload) if "rvl" in described.lower() else _decode_png(payload)
    if encoding.upper() == "16UC1":
        return values
    inverse = values.astype(np.float32) - np.float32(b)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.float32(a) / inverse
    depth[values == 0] = np.nan
    return depth


def _decode_png(data: bytes) -> NDArray[np.uint16]:
    import cv2

    width, height = picture_size(data)
    if width * height > limits().image_pixels:
        raise LogError(f"a depth image claims {width} x {height} pixels")
    cells = decoded_file(data, cv2.IMREAD_UNCHANGED)
    if cells is None or cells.ndim != 2:
        raise LogError(f"a compressedDepth image of {len(data)} bytes cannot be decoded")
    return np.asarray(cells, np.uint16)


def decode_rvl(data: bytes) -> NDArray[np.uint16]:
    """Depth (H, W) of RVL's variable-length nibbles; LogError where they are damaged."""
    if len(data) < _RVL_SIZE.size:
        raise LogError("an RVL depth image is cut")
    width, height = _RVL_SIZE.unpack_from(data)
    pixels = width * height
    # Four bits a run at the very least, and a run is at most as long as the image.
    if not 0 < pixels <= limits().image_pixels:
        raise LogError(f"an RVL depth image claims {width} x {height} pixels")
    numbers = _numbers(data[_RVL_SIZE.size :])
    depth = np.zeros(pixels, np.uint16)
    at = number = 0
    previous = 0
    try:
        while at < pixels:
            at += int(numbers[number])  # pixels without depth
            run = int(numbers[number + 1])
            deltas = numbers[number + 2 : number + 2 + run]
            if len(deltas) < run or at + run > pixels or run == numbers[number] == 0:
                raise LogError("an RVL depth image is damaged")
            signed = (deltas >> 1) ^ -(deltas & 1)
            values = previous + np.cumsum(signed)
            depth[at : at + run] = values.astype(np.uint16)
            previous = int(values[-1]) if run else previous
            at, number = at + run, number + 2 + run
    except IndexError as error:
        raise LogError("an RVL depth image is cut") from error
    return depth.reshape(height, width)


def _numbers(data: bytes) -> NDArray[np.int64]:
    """All variable-length integers: three bits a nibble, low first, the fourth says "more"."""
    words = np.frombuffer(data[: len(data) // 4 * 4], "<u4")
    shifts = np.arange(28, -4, -4, dtype=np.uint32)
    nibbles = ((words[:, None] >> shifts) & 15).reshape(-1).astype(np.int64)
    ends = np.flatnonzero(nibbles < 8)
    if len(ends) == 0:
        return np.zeros(0, np.int64)
    starts = np.concatenate([[0], ends[:-1] + 1])
    nibbles = nibbles[: ends[-1] + 1]
    place = np.arange(len(nibbles)) - np.repeat(starts, ends - starts + 1)
    if place.max(initial=0) > 10:
        raise LogError("an RVL depth image is damaged")
    return np.add.reduceat((nibbles & 7) << (3 * place), starts)

"""The payload of ROS's compressedDepth transport: a header, then PNG or RVL.

Twelve bytes of header (format, two quantisation parameters), then the file. 16UC1 is millimetres;
32FC1 is inverse depth, quantised: depth = A / (value - B).
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from formats.limits import limits
from formats.picture_files import decoded_file
from mapmyworld.errors import LogError

_HEADER = struct.Struct("<iff")
_RVL_SIZE = struct.Struct("<II")


def decode_compressed_depth(data: bytes, encoding: str, described: str) -> NDArray[np.generic]:
    """Depth (H, W): uint16 millimetres for 16UC1, float32 metres (NaN = none) for 32FC1.

    Raises `LogError` where there is none.
    """
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

    cells = decoded_file(data, cv2.IMREAD_UNCHANGED)
    if cells is None or cells.ndim != 2:
        raise LogError(f"a compressedDepth image of {len(data)} bytes cannot be decoded")
    return np.asarray(cells, np.uint16)


def decode_rvl(data: bytes) -> NDArray[np.uint16]:
    """Depth (H, W) of a size and the RVL words behind it; LogError where these are damaged."""
    from formats.rvl import rvl_decode

    if len(data) < _RVL_SIZE.size:
        raise LogError("an RVL depth image is cut")
    width, height = _RVL_SIZE.unpack_from(data)
    pixels = width * height
    # Four bits a run at the very least, and a run is at most as long as the image.
    if not 0 < pixels <= limits().image_pixels:
        raise LogError(f"an RVL depth image claims {width} x {height} pixels")
    try:
        return rvl_decode(data[_RVL_SIZE.size :], height, width)
    except ValueError:
        raise LogError("an RVL depth image is damaged or cut") from None

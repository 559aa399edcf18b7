"""Pixels of recorded images, raw or compressed, decoded when they are asked for."""

from __future__ import annotations

from functools import partial
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from formats.limits import limits
from formats.picture_files import decoded_file, is_16_bit_png, picture_size
from mapmyworld.errors import LogError
from mapmyworld.types import ImageMessage

_FILES = (b"\xff\xd8", b"\x89PNG", b"RIFF")  # JPEG, PNG, WebP; other decoders are not let near
_MILLIMETRES = 1000.0  # units of 16-bit depth in a metre (REP-118)
_HEADER = Struct("<iff")  # of ROS's compressedDepth transport
_RVL_SIZE = Struct("<II")
_DEPTH = frozenset({"16UC1", "32FC1", "MONO16", "Z16"})
# Encoding -> bytes a channel, channels, and what OpenCV calls the way to RGB, where there is one.
_LAYOUTS = {
    "rgb8": (1, 3, ""), "bgr8": (1, 3, "BGR2RGB"), "8UC3": (1, 3, "BGR2RGB"),
    "rgb16": (2, 3, ""), "bgr16": (2, 3, "BGR2RGB"), "8UC4": (1, 4, "BGRA2RGB"),
    "rgba8": (1, 4, "RGBA2RGB"), "bgra8": (1, 4, "BGRA2RGB"),
    "rgba16": (2, 4, "RGBA2RGB"), "bgra16": (2, 4, "BGRA2RGB"),
    "mono8": (1, 1, ""), "8UC1": (1, 1, ""),
    "mono16": (2, 1, ""), "16UC1": (2, 1, ""), "z16": (2, 1, ""), "32FC1": (4, 1, ""),
    "yuv422": (1, 2, "YUV2RGB_UYVY"), "uyvy": (1, 2, "YUV2RGB_UYVY"),
    "yuv422_yuy2": (1, 2, "YUV2RGB_YUY2"), "yuyv": (1, 2, "YUV2RGB_YUY2"),
    # OpenCV names a pattern by its second row, second column.
    **{
        f"bayer_{pattern}{8 * size}": (size, 1, f"Bayer{name}2RGB")
        for pattern, name in {"rggb": "BG", "bggr": "RG", "gbrg": "GR", "grbg": "GB"}.items()
        for size in (1, 2)
    },
}  # fmt: skip


def raw_pixels(
    encoding: str, width: int, height: int, step: int, data: bytes | memoryview, big_endian: bool
) -> NDArray[np.generic]:
    """Pixels (H, W, ...) of rows of `step` bytes, as `ImageMessage` has them. Raises `LogError`."""
    layout = _LAYOUTS.get(encoding) or _LAYOUTS.get(encoding.lower())
    if layout is None:
        raise LogError(f"image encoding {encoding!r} is not known: record rgb8, mono8 or 16UC1")
    size, channels, way = layout
    row_bytes = width * size * channels
    step = step or row_bytes
    if not (0 < width * height <= limits().image_pixels and row_bytes <= step) or (
        step * (height - 1) + row_bytes > len(data)
    ):
        raise LogError(f"an image of {width} x {height} {encoding} does not fit its data")
    whole = np.frombuffer(data, np.uint8, step * (height - 1) + row_bytes)
    rows = np.lib.stride_tricks.as_strided(whole, (height, row_bytes), (step, 1), writeable=False)
    kind = {1: "u1", 2: "u2", 4: "f4"}[size]
    cells = np.ascontiguousarray(rows).view((">" if big_endian else "<") + kind)
    cells = cells.reshape(height, width, channels).astype(kind, copy=False)
    return metres_from_depth(cells[..., 0]) if encoding.upper() in _DEPTH else _picture(cells, way)


def _picture(cells: NDArray[np.generic], way: str) -> NDArray[np.generic]:
    """RGB or grey of cells (H, W, C) as recorded; of 16 bits the high bytes."""
    if cells.dtype.itemsize == 2:
        cells = np.asarray((cells.astype(np.uint16) >> 8).astype(np.uint8))
    if not way:
        return cells[..., 0] if cells.shape[2] == 1 else cells
    import cv2

    return np.asarray(cv2.cvtColor(cells, getattr(cv2, f"COLOR_{way}")))


def metres_from_depth(
    cells: NDArray[np.generic], units: float = _MILLIMETRES
) -> NDArray[np.float32]:
    """Depth in metres, 0 where there is none, of `units` a metre or float metres; (H, W) both."""
    if cells.dtype.kind == "u":
        return np.asarray(cells.astype(np.float32) / np.float32(units), np.float32)
    metres = cells.astype(np.float32)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0)).astype(np.float32)


def compressed_image(stamp_ns: int, frame_id: str, described: str, data: bytes) -> ImageMessage:
    """An image that arrived as a JPEG, PNG or WebP file, or by compressedDepth.

    `described` is the message's format: "jpeg", "rgb8; jpeg compressed bgr8",
    "16UC1; compressedDepth png", ...
    """
    encoding = described.split(";")[0].strip()
    if "compresseddepth" in described.lower():
        encoding = encoding if encoding.upper() in {"16UC1", "32FC1"} else "16UC1"
        decode = partial(decode_compressed_depth, data, encoding, described)
        file = data[12:] if encoding == "16UC1" and data[12:16] == b"\x89PNG" else None
        return ImageMessage(stamp_ns, frame_id, encoding, *picture_size(data[12:]), decode, file)
    if encoding.lower() in {"jpeg", "jpg", "png", "webp", "avif", ""} or encoding not in _LAYOUTS:
        encoding = "16UC1" if is_16_bit_png(data) else "rgb8"
    size = picture_size(data)
    return ImageMessage(
        stamp_ns, frame_id, encoding, *size, partial(encoded_pixels, data, encoding), data
    )


def decode_compressed_depth(data: bytes, encoding: str, described: str) -> NDArray[np.float32]:
    """Depth (H, W) in metres, 0 where there is none; raises `LogError` where there is no image.

    Twelve bytes of header (format, two quantisation parameters), then PNG or RVL. 16UC1 is
    millimetres; 32FC1 is inverse depth, quantised: depth = A / (value - B).
    """
    if len(data) <= _HEADER.size:
        raise LogError("a compressedDepth image without content")
    _, a, b = _HEADER.unpack_from(data)
    payload = data[_HEADER.size :]
    values = decode_rvl(payload) if "rvl" in described.lower() else _decode_png(payload)
    if encoding.upper() == "16UC1":
        return metres_from_depth(values)
    inverse = values.astype(np.float32) - np.float32(b)
    with np.errstate(divide="ignore", invalid="ignore"):
        return metres_from_depth(np.where(values == 0, 0, np.float32(a) / inverse))


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


def encoded_pixels(data: bytes, encoding: str, units: float = _MILLIMETRES) -> NDArray[np.generic]:
    """Pixels of a JPEG, PNG or WebP file: colour (H, W, 3) RGB, grey (H, W), depth (H, W).

    Depth is in metres, of `units` a metre. Raises `LogError` where the file is damaged.
    """
    import cv2

    depth = encoding.upper() in _DEPTH
    if not data.startswith(_FILES):
        raise LogError("a compressed image cannot be decoded: it is no JPEG, PNG or WebP file")
    width, height = picture_size(data)
    if width * height > limits().image_pixels:
        raise LogError(f"a compressed image claims {width} x {height} pixels")
    mode = cv2.IMREAD_UNCHANGED if depth else cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
    cells = decoded_file(data, mode)
    if cells is None:
        raise LogError(f"a compressed image of {len(data)} bytes cannot be decoded")
    if depth:
        return metres_from_depth(cells if cells.ndim == 2 else cells[..., 0], units)
    if cells.ndim == 2 and encoding.lower().startswith("bayer"):
        way = _LAYOUTS[encoding.lower()][2]
        return _picture(cells[..., None], way)  # the mosaic was compressed as it was
    return np.ascontiguousarray(cells if cells.ndim == 2 else cells[..., 2::-1])

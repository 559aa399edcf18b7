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
# Encoding -> bytes a channel, channels.
_LAYOUTS = {
    "rgb8": (1, 3), "bgr8": (1, 3), "rgba8": (1, 4), "bgra8": (1, 4),
    "rgb16": (2, 3), "bgr16": (2, 3), "rgba16": (2, 4), "bgra16": (2, 4),
    "mono8": (1, 1), "mono16": (2, 1), "8UC1": (1, 1), "8UC3": (1, 3), "8UC4": (1, 4),
    "16UC1": (2, 1), "z16": (2, 1), "32FC1": (4, 1),
    "bayer_rggb8": (1, 1), "bayer_bggr8": (1, 1), "bayer_gbrg8": (1, 1), "bayer_grbg8": (1, 1),
    "bayer_rggb16": (2, 1), "bayer_bggr16": (2, 1), "bayer_gbrg16": (2, 1), "bayer_grbg16": (2, 1),
    "yuv422": (1, 2), "uyvy": (1, 2), "yuv422_yuy2": (1, 2), "yuyv": (1, 2),
}  # fmt: skip


def raw_pixels(
    encoding: str, width: int, height: int, step: int, data: bytes | memoryview, big_endian: bool
) -> NDArray[np.generic]:
    """Pixels (H, W, ...) of rows of `step` bytes, as `ImageMessage` has them. Raises `LogError`."""
    layout = _LAYOUTS.get(encoding) or _LAYOUTS.get(encoding.lower())
    if layout is None:
        raise LogError(f"image encoding {encoding!r} is not known: record rgb8, mono8 or 16UC1")
    size, channels = layout
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
    return _converted(encoding, cells.reshape(height, width, channels).astype(kind, copy=False))


def _converted(encoding: str, cells: NDArray[np.generic]) -> NDArray[np.generic]:
    """Cells (H, W, C) as recorded -> RGB, grey or metres."""
    name = encoding.lower()
    if name in {"16uc1", "mono16", "z16", "32fc1"}:
        return metres_from_depth(cells[..., 0])
    if name.startswith("bayer"):
        return _from_bayer(name, cells[..., 0])
    if name in {"yuv422", "uyvy", "yuv422_yuy2", "yuyv"}:
        return _from_yuv(name, cells)
    cells = _eight_bits(cells)
    if cells.shape[2] == 1:
        return np.ascontiguousarray(cells[..., 0])
    blue_first = name.startswith("bgr") or name in {"8uc3", "8uc4"}
    return np.ascontiguousarray(cells[..., 2::-1] if blue_first else cells[..., :3])


def _eight_bits(cells: NDArray[np.generic]) -> NDArray[np.generic]:
    """The high bytes of 16-bit cells; others as they are."""
    if cells.dtype.itemsize == 1:
        return cells
    return np.asarray((cells.astype(np.uint16) >> 8).astype(np.uint8))


def metres_from_depth(
    cells: NDArray[np.generic], units: float = _MILLIMETRES
) -> NDArray[np.float32]:
    """Depth in metres, 0 where there is none, of `units` a metre or float metres; (H, W) both."""
    if cells.dtype.kind == "u":
        return np.asarray(cells.astype(np.float32) / np.float32(units), np.float32)
    metres = cells.astype(np.float32)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0)).astype(np.float32)


def _from_bayer(name: str, cells: NDArray[np.generic]) -> NDArray[np.generic]:
    import cv2

    # OpenCV names a pattern by its second row, second column.
    code = {"rggb": "BG", "bggr": "RG", "gbrg": "GR", "grbg": "GB"}[name[6:10]]
    return np.asarray(cv2.cvtColor(_eight_bits(cells), getattr(cv2, f"COLOR_Bayer{code}2RGB")))


def _from_yuv(name: str, cells: NDArray[np.generic]) -> NDArray[np.generic]:
    import cv2

    order = "UYVY" if name in {"yuv422", "uyvy"} else "YUY2"
    return np.asarray(cv2.cvtColor(cells, getattr(cv2, f"COLOR_YUV2RGB_{order}")))


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

    depth = encoding.upper() in {"16UC1", "32FC1", "MONO16", "Z16"}
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
        return _from_bayer(encoding.lower(), cells)  # the mosaic was compressed as it was
    return np.ascontiguousarray(cells if cells.ndim == 2 else cells[..., 2::-1])
